"""Inputs that are Entwine point tiles (EPT): the nodes that a run may need, and the CRS that their files leave out."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

from pyproj import CRS

from tiler.config import RunConfig
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.errors import ConfigError
from tiler.ingest import (
    PointTiles,
    SourceInfo,
    Touches,
    bounds_in_counts,
    describe,
    is_point_tiles,
    read_point_tiles,
)
from tiler.plan.area import area_of
from tiler.plan.model import Plan

NEAR_M = 1000
"""Metres around the area, besides what settings ask for, within which nodes are looked at; the plan takes what it needs
of these when it knows how far that is."""
NODES_FOLDER, NAME = "ept-data", "ept.json"


def near_nodes(config: RunConfig, tiles: PointTiles) -> Touches | None:
    """What tells whether the square of a node comes near the area of a run; None where there is none."""
    area = area_of(config, tiles.wkt, [])
    if area is None:
        return None
    crs = None if tiles.wkt is None else describe(CRS.from_wkt(tiles.wkt))
    unit = 1 if crs is None or crs.horizontal is None else crs.horizontal
    reach = math.ceil(_reach_m(config) / unit * COUNTS_PER_UNIT)
    return lambda box: area.touches(bounds_in_counts(box).pad(reach))


def refuse_far(plan: Plan, inputs: Sequence[str]) -> None:
    """Raise ConfigError where a run needs points farther from its area than nodes of point tiles were looked for."""
    reach = _reach_m(plan.config)
    if (
        plan.area is not None
        and any(map(is_point_tiles, inputs))
        and plan.margin > plan.meta.frame.counts(reach)
    ):
        raise ConfigError(
            f"--halo: of {NAME} nodes are looked for {float(reach):g} m around the area, this run needs points farther "
            "off; use a smaller halo, or no --bounds"
        )


def _reach_m(config: RunConfig) -> Fraction:
    return NEAR_M + Fraction(config.max_edge) + Fraction(config.halo or 0)


def with_crs_of_tiles(inputs: Sequence[str], sources: Iterable[SourceInfo]) -> list[SourceInfo]:
    """Sources; those that are nodes of point tiles among the inputs, and have no CRS, with that of ``ept.json``."""
    if not any(map(is_point_tiles, inputs)):
        return list(sources)
    known: dict[Path, str | None] = {}
    found = []
    for source in sources:
        folder = source.path.parent
        if source.georeference.kind == "missing" and folder.name == NODES_FOLDER:
            if folder not in known:
                known[folder] = read_point_tiles(str(folder.parent / NAME)).wkt
            wkt = known[folder]
            source = source if wkt is None else replace(source, georeference=describe(CRS.from_wkt(wkt)))
        found.append(source)
    return found
