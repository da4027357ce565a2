"""Bodies of water and edits around a block of a raster."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tiler.core.edits import FLAT, OF_PIXELS, Edit
from tiler.core.raster import Block, RasterSpec
from tiler.core.water import Waters
from tiler.store import TileStore

Bools = npt.NDArray[np.bool_]
Heights = npt.NDArray[np.float32]


@dataclass(frozen=True)
class WatersNear:
    """Bodies of water that touch a block."""

    waters: Waters | None
    spec: RasterSpec
    block: Block

    @property
    def inside(self) -> Bools:
        """Mask of the pixels in water, bool (height, width)."""
        if self.waters is None:
            return np.zeros((self.block.height, self.block.width), np.bool_)
        return self.waters.inside(self.spec, self.block)

    def set_heights(self, heights: Heights, where: Bools) -> list[tuple[str, int]]:
        """Set the heights of the water's pixels in the mask ``where``, see `Waters.set_heights`."""
        if self.waters is None:
            return []
        return self.waters.set_heights(self.spec, self.block, heights, where)


@dataclass(frozen=True)
class EditsNear:
    """Edits that touch a block, under a key of the store; None if the run has none."""

    store: TileStore
    key: str | None
    spec: RasterSpec
    block: Block

    def of(self, actions: Iterable[str]) -> tuple[Edit, ...]:
        """Return the edits with one of the actions."""
        if self.key is None:
            return ()
        edits = self.store.edits(self.key, self.spec.block_bounds(self.block), actions)
        return () if edits is None else edits.edits

    @property
    def flat(self) -> Bools:
        """Mask of the pixels whose height an edit sets, bool (height, width)."""
        mask = np.zeros((self.block.height, self.block.width), np.bool_)
        for edit in self.of((FLAT,)):
            mask |= self.spec.inside(self.block, edit.area)
        return mask

    def set_heights(self, heights: Heights) -> list[tuple[int, int]]:
        """Set the heights of edits, see `Edits.set_heights`."""
        if self.key is None:
            return []
        edits = self.store.edits(self.key, self.spec.block_bounds(self.block), OF_PIXELS)
        return [] if edits is None else edits.set_heights(self.spec, self.block, heights)
