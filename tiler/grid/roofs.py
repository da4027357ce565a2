"""Warning about terrain that looks like a roof."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.ground.plateaus import ROOF_CELL_M
from ptd.ground.remaining_roofs import reach_m, remaining_roofs
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec, north_west
from tiler.core.units_text import length_text
from tiler.grid.steps import Counts
from tiler.store import TileStore

Float64 = npt.NDArray[np.float64]

TOO_WIDE = 0.8
"""Share of ``max_building_size`` from which the width of a roof in the terrain causes a
warning."""
PART_CELLS = 500
"""Side in cells of the parts in which terrain is examined. One part is in memory at a time."""
STRIP_ROWS = 512
"""Rows of pixels of a part that are read in one batch."""


class Advice(NamedTuple):
    """Warning about a position in the terrain, with x and y in units of the CRS."""

    text: str
    x: float
    y: float


def find_roofs(
    store: TileStore,
    *,
    spec: RasterSpec,
    filled: tuple[str, ...],
    building_m: float,
    roof_m: float | None,
    waters: str | None,
) -> Counts:
    """Search for roofs on a worker, which has loaded the kernels. The ``advice`` is a warning, or None.

    The arguments are those of `roofs_in_terrain`, with ``filled`` as the names of blocks.
    """
    blocks = (spec.block_named(key, BLOCK_PIXELS) for key in filled)
    return {"advice": roofs_in_terrain(store, "dtm", spec, blocks, building_m, roof_m, waters)}


def roofs_in_terrain(
    store: TileStore,
    name: str,
    spec: RasterSpec,
    filled: Iterable[Block],
    building_m: float,
    roof_m: float | None = None,
    waters: str | None = None,
) -> Advice | None:
    """Return a warning if the terrain has a roof that is too wide for the settings, else None.

    Parameters
    ----------
    store : TileStore
    name : str
        Name of the raster of the terrain.
    spec : RasterSpec
    filled : iterable of Block
        Blocks with heights. Other blocks are not examined.
    building_m : float
        Setting ``max_building_size`` of the method in metres.
    roof_m : float, optional
        Widest roof for which the method itself searches, in metres.
    waters : str, optional
        Key in the store of bodies of water. Their heights do not count, because land next to water is higher and would
        look like a roof.
    """
    frame = store.meta.frame
    pixel = float(spec.lattice.size * frame.metres_xy)
    times = max(int(ROOF_CELL_M / pixel), 1)
    core, pad = PART_CELLS * times, math.ceil(reach_m(pixel * times) / pixel / times) * times
    widest, where = 0.0, None
    parts = {
        part
        for block in filled
        for part in spec.blocks_within(spec.block_bounds(_wider(block, pad)), core)
    }
    for block in sorted(parts, key=north_west):
        top, left = max(block.row - pad, 0), max(block.col - pad, 0)
        bottom = min(block.row + block.height + pad, spec.height)
        right = min(block.col + block.width + pad, spec.width)
        part = _part(
            store, name, waters, spec, Block(top, left, bottom - top, right - left), times
        )
        heights = np.where(part == np.float32(NODATA), np.nan, part) * float(
            frame.units.vertical
        )
        for roof in remaining_roofs(heights, pixel * times, TOO_WIDE * building_m):
            if roof.width_m > widest:
                widest, where = (
                    roof.width_m,
                    (top + int(roof.row * times), left + int(roof.column * times)),
                )
    if where is None:
        return None
    x, y = _place(spec, *where)
    unit = frame.units.horizontal
    setting, metres = "max_building_size", building_m
    if roof_m is not None and widest > roof_m:
        setting, metres = "roof_size", roof_m
    suggested_m = math.ceil(1.2 * max(widest, metres) / 10) * 10
    wide = length_text(round(widest), unit)
    text = (
        f"the terrain holds what looks like a roof {wide} wide, at x {x:.0f}, y {y:.0f}, and {setting} "
        f"is {length_text(metres, unit)}; if it is one, use --set {setting}={suggested_m}"
    )
    return Advice(text, x, y)


def _wider(block: Block, pad: int) -> Block:
    return Block(
        block.row - pad, block.col - pad, block.height + 2 * pad, block.width + 2 * pad
    )


def _place(spec: RasterSpec, row: int, col: int) -> tuple[float, float]:
    a, _, x, _, e, y = spec.transform(COUNTS_PER_UNIT)
    return x + a * col, y + e * row


def _part(
    store: TileStore, name: str, waters: str | None, spec: RasterSpec, part: Block, times: int
) -> Float64:
    """Return the thinned heights of a part, read strip by strip. Water has none."""
    step = max(STRIP_ROWS // times, 1) * times
    last = part.row + part.height
    rows = []
    for row in range(part.row, last, step):
        strip = Block(row, part.col, min(step, last - row), part.width)
        heights = store.read_block(name, strip)
        bodies = store.waters(waters, spec.block_bounds(strip))
        if bodies is not None:
            heights[bodies.inside(spec, strip)] = NODATA
        rows.append(thinned(heights, times))
    return np.concatenate(rows)


def thinned(heights: npt.NDArray[np.float32], times: int) -> Float64:
    """Return the height of one pixel per ``times`` by ``times``. Unlike averaging, thinning keeps steep edges."""
    return heights[times // 2 :: times, times // 2 :: times].astype(np.float64)
