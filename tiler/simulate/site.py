"""Site of a survey: terrain and its objects, made block by block on demand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tiler.simulate.objects import Objects
from tiler.simulate.plot import Plot
from tiler.simulate.randomness import BLOCKS, generator
from tiler.simulate.terrain import Terrain

BLOCK_REACH_M = 15.0
"""Distance in metres by which the objects of a block may reach beyond it."""

KEPT_BLOCKS = 256
"""Number of blocks kept in memory, which bounds the memory for a city of any size."""


@dataclass(frozen=True)
class Site:
    """Terrain and its objects, with x from 0 to ``side_m`` and y from 0 to ``north_m`` metres.

    Attributes
    ----------
    terrain : Terrain
    side_m : float
    seed : int
        Seed of the random numbers of blocks and sensors.
    fill : callable, optional
        Function that places objects on a `Plot`. With None, blocks are bare.
    block_m : float
        Side of a block in metres. Blocks are a lattice at (0, 0).
    landmarks : Objects
        Objects that extend across blocks: bridges and power lines.
    street_m : float
        Width of the asphalt along the edges of the blocks, metres.
    green : float
        Share of lawn on open ground. The rest is soil.
    """

    terrain: Terrain
    side_m: float
    seed: int = 0
    fill: Callable[[Plot], None] | None = None
    block_m: float = 50.0
    landmarks: Objects = field(default_factory=Objects)
    street_m: float = 0.0
    green: float = 0.6
    north_m: float = 0.0
    _blocks: dict[tuple[int, int], Objects] = field(
        default_factory=dict, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        if not self.north_m:
            object.__setattr__(self, "north_m", self.side_m)

    def objects_near(self, x0: float, y0: float, x1: float, y1: float) -> Objects:
        """Return all objects that may reach into a box (metres).

        Their order depends only on the box.
        """
        objects = self.landmarks.touching(x0, y0, x1, y1)
        if self.fill is None:
            return objects
        low_x, low_y, high_x, high_y = (
            int(np.floor(edge / self.block_m))
            for edge in (
                x0 - BLOCK_REACH_M,
                y0 - BLOCK_REACH_M,
                x1 + BLOCK_REACH_M,
                y1 + BLOCK_REACH_M,
            )
        )
        for iy in range(low_y, high_y + 1):
            for ix in range(low_x, high_x + 1):
                objects = objects + self._block(ix, iy).touching(x0, y0, x1, y1)
        return objects

    def _block(self, ix: int, iy: int) -> Objects:
        if (ix, iy) not in self._blocks:
            if len(self._blocks) >= KEPT_BLOCKS:
                del self._blocks[next(iter(self._blocks))]
            centre = (ix + 0.5) * self.block_m, (iy + 0.5) * self.block_m
            rng = generator(self.seed, BLOCKS, ix, iy)
            plot = Plot(rng, self.terrain, *centre, self.block_m, self.landmarks, self.street_m)
            if self.fill is not None:
                self.fill(plot)
            self._blocks[ix, iy] = plot.objects()
        return self._blocks[ix, iy]
