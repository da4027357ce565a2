"""Simulated closed canopies as image matching sees them: flat and hilly, with and without clearings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tiler.simulate import DimSensor, SimulatedPoints, Site, Terrain, survey
from tiler.simulate.site import Plot
from tiler.simulate.terrain import Waves

STEP_M = 5.0
"""Trees stand in squares of this side, one in each, with crowns that reach as far: no ground is
seen between them."""
BLOCK_M = 40.0
"""Side of the blocks of wood, of clearings, and of the lawns around a wood without
clearings."""
SENSOR = {
    "density": 2.4,
    "sigma_m": 0.1,
    "tails": 4.0,
    "shadow": 2.0,
    "facade": 0.0,
    "edge_m": 1.2,
    "correlated": 0.5,
}
"""As sparse and as smooth as clouds of drones over forest are: crowns are hills of one surface
in them."""


@dataclass(frozen=True)
class Canopy:
    """A closed wood, 14 to 22 m tall.

    Attributes
    ----------
    hilly : bool
        Hills of 12 m, instead of a gentle slope.
    clearings : bool
        Every fourth block is a lawn; else the outermost ones are.
    side_m : float
    seed : int
    """

    hilly: bool
    clearings: bool
    side_m: float = 240.0
    seed: int = 1

    def site(self) -> Site:
        """Terrain and trees."""
        rng = np.random.default_rng(self.seed)
        shapes = (
            (Waves.random(rng, 12.0, 180.0), Waves.random(rng, 1.5, 40.0)) if self.hilly else ()
        )
        terrain = Terrain(300.0, (0.1, 0.15) if self.hilly else (0.02, 0.01), shapes)
        return Site(terrain, self.side_m, self.seed, self._plant, BLOCK_M, green=0.9)

    def points(self) -> SimulatedPoints:
        """The cloud."""
        return survey(self.site(), DimSensor(**SENSOR))

    def share(self) -> float:
        """Share of the area that is wood."""
        blocks = (np.arange(self.side_m / BLOCK_M) + 0.5) * BLOCK_M
        return float(np.mean([not self._is_lawn(x, y) for x in blocks for y in blocks]))

    def _plant(self, plot: Plot) -> None:
        if self._is_lawn(plot.x, plot.y):
            return
        places = np.arange(STEP_M / 2, BLOCK_M, STEP_M) - BLOCK_M / 2
        for north in places:
            for east in places:
                x, y = plot.rng.uniform(-1.5, 1.5, 2) + (plot.x + east, plot.y + north)
                plot.tree(float(x), float(y), plot.rng.uniform(14.0, 22.0), widest=STEP_M)

    def _is_lawn(self, x: float, y: float) -> bool:
        column, row, last = x // BLOCK_M, y // BLOCK_M, self.side_m // BLOCK_M - 1
        if self.clearings:
            return bool(column % 2 == 1 and row % 2 == 1)
        return not (0 < column < last and 0 < row < last)
