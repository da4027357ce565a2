"""Warnings, each with its remedy, where the data contradict the settings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import numpy.typing as npt

from ptd.ground.left_roofs import left_roofs, reach_m
from ptd.ground.plateaus import ROOF_CELL_M
from tiler.config import RunConfig
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.raster import NODATA, Block, RasterSpec, north_west
from tiler.ingest import SourceInfo
from tiler.store import TileStore

Float64 = npt.NDArray[np.float64]

FOR_SCANNERS = ("classic", "chen2023", "ridge2016")
"""Methods whose defaults are made for laser scanning."""
MATCHED_DENSITY = 12.0
"""Points per m2 from which colours and single returns mean image matching: coloured scans with their returns taken off
are sparser."""

COLOURS_WITHOUT_TIME = 2
"""Point format of matched clouds: scanners keep the time of each pulse."""

TOO_WIDE = 0.8
"""A roof that is left in the terrain is warned of from this share of ``max_building_size`` on."""
PART_CELLS = 500
"""Side, in cells, of the parts in which terrain is examined: memory is that of one."""
STRIP_ROWS = 512
"""Pixels of a part that are read at once."""


def before(
    sources: Sequence[SourceInfo], config: RunConfig, density: float, halo_m: float | None
) -> Iterator[str]:
    """Warnings that follow from headers and a sample of points.

    Parameters
    ----------
    sources : sequence of SourceInfo
        With points.
    config : RunConfig
    density : float
        Points per m2.
    halo_m : float or None
        With which tiles of the method seldom need more; None where every pass has a fixed reach.
    """
    if config.method in FOR_SCANNERS and all(_looks_matched(s, density) for s in sources):
        yield (
            f"the points look like image matching (colours, one return each), and method "
            f"{config.method} is made for laser scanning; use --preset dim"
        )
    spacing = 1 / math.sqrt(density)
    if config.resolution is not None and float(config.resolution) < 0.7 * spacing:
        coarser = math.ceil(spacing * 10) / 10
        yield (
            f"--resolution {float(config.resolution):g} m is finer than the points, which are {spacing:.2g} m apart: "
            f"most pixels will be interpolated; use --resolution {coarser:g}"
        )
    if config.halo is not None and halo_m is not None and float(config.halo) < halo_m / 2:
        yield (
            f"--halo {float(config.halo):g} m is too small for method {config.method}: most tiles will be done again "
            f"with more; leave it out, or use --halo {halo_m:g}"
        )


def _looks_matched(source: SourceInfo, density: float) -> bool:
    return (
        source.has_rgb
        and source.returns <= 1
        and (density >= MATCHED_DENSITY or source.point_format == COLOURS_WITHOUT_TIME)
    )


def roofs_in_terrain(
    store: TileStore,
    name: str,
    spec: RasterSpec,
    filled: Iterable[Block],
    building_m: float,
    roof_m: float | None = None,
) -> str | None:
    """A warning if the terrain holds what looks like a roof too wide for ``max_building_size`` or ``roof_size``.

    Parameters
    ----------
    store : TileStore
    name : str
        Raster of the terrain.
    spec : RasterSpec
    filled : iterable of Block
        That hold heights: nothing else is looked at.
    building_m : float
        The method's largest building, metres.
    roof_m : float, optional
        The widest roof that the method looks for itself, metres.
    """
    frame = store.meta.frame
    pixel = float(spec.lattice.size * frame.metres_xy)
    times = max(int(ROOF_CELL_M / pixel), 1)
    core, pad = PART_CELLS * times, math.ceil(reach_m(pixel * times) / pixel / times) * times
    widest, where = 0.0, None
    parts = {
        part for block in filled for part in spec.blocks_within(spec.block_bounds(_wider(block, pad)), core)
    }
    for block in sorted(parts, key=north_west):
        top, left = max(block.row - pad, 0), max(block.col - pad, 0)
        bottom = min(block.row + block.height + pad, spec.height)
        right = min(block.col + block.width + pad, spec.width)
        part = _part(store, name, Block(top, left, bottom - top, right - left), times)
        heights = np.where(part == np.float32(NODATA), np.nan, part) * float(frame.units.vertical)
        for roof in left_roofs(heights, pixel * times, TOO_WIDE * building_m):
            if roof.width_m > widest:
                widest, where = roof.width_m, (top + int(roof.row * times), left + int(roof.column * times))
    if where is None:
        return None
    x, y = _place(spec, *where)
    setting, metres = "max_building_size", building_m
    if roof_m is not None and widest > roof_m:
        setting, metres = "roof_size", roof_m
    wanted = math.ceil(1.2 * max(widest, metres) / 10) * 10
    return (
        f"the terrain holds what looks like a roof {widest:.0f} m wide, at x {x:.0f}, y {y:.0f}, and {setting} "
        f"is {metres:g} m; if it is one, use --set {setting}={wanted}"
    )


def _wider(block: Block, pad: int) -> Block:
    return Block(block.row - pad, block.col - pad, block.height + 2 * pad, block.width + 2 * pad)


def _place(spec: RasterSpec, row: int, col: int) -> tuple[float, float]:
    a, _, x, _, e, y = spec.transform(COUNTS_PER_UNIT)
    return x + a * col, y + e * row


def _part(store: TileStore, name: str, part: Block, times: int) -> Float64:
    """Pooled heights of a part, read strip by strip."""
    step = max(STRIP_ROWS // times, 1) * times
    last = part.row + part.height
    strips = [Block(row, part.col, min(step, last - row), part.width) for row in range(part.row, last, step)]
    return np.concatenate([pooled(store.read_block(name, strip), times) for strip in strips])


def pooled(heights: npt.NDArray[np.float32], times: int) -> Float64:
    """The heights of every so many-th pixel: thinning keeps what stands steep, means would blur it."""
    return heights[times // 2 :: times, times // 2 :: times].astype(np.float64)
