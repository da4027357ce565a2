"""Inputs that are Entwine Point Tiles (EPT): nodes that a run may need, and their CRS.

If ``ept.json`` and the files of its nodes contradict each other, the files count, and notes report it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

from pyproj import CRS

from tiler.config import RunConfig
from tiler.core.area import Area
from tiler.core.crs import same_horizontal, split
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.errors import ConfigError
from tiler.inputs import (
    EptDataset,
    Georeference,
    SourceInfo,
    bounds_in_counts,
    describe,
    is_ept,
    key_of,
)
from tiler.plan.area import area_of
from tiler.plan.model import Plan

_CARELESS = 1.0
"""Tolerance, in units of the CRS, by which points may lie outside their node: some writers round inaccurately."""

Told = str | None

NEAR_M = 1000
"""Distance in metres around the area within which nodes are read, in addition to ``--max-edge`` and ``--halo``.

The plan reduces the selection once the margin of the method is known.
"""


@dataclass(frozen=True)
class Near:
    """Predicate for boxes within ``reach`` counts of an area."""

    area: Area
    reach: int

    def __call__(self, box: tuple[float, float, float, float]) -> bool:
        """Return whether a box in units of the CRS lies near the area."""
        return self.area.touches(bounds_in_counts(box).pad(self.reach))


class TilesOfRun:
    """EPT data sets among the inputs of a run, with the nodes that are read."""

    def __init__(self, config: RunConfig) -> None:
        self._config = config
        self._found: list[tuple[EptDataset, dict[Path, int]]] = []

    def wanted(self, tiles: EptDataset) -> Near | None:
        """Return a predicate for nodes near the area of the run, or None if there is no area."""
        area = area_of(self._config, tiles.wkt, [])
        if area is None:
            return None
        unit = None
        if tiles.wkt is not None:
            unit = describe(CRS.from_wkt(tiles.wkt)).horizontal
        return Near(area, math.ceil(_reach_m(self._config) / (unit or 1) * COUNTS_PER_UNIT))

    def listed(self, tiles: EptDataset, counts: dict[Path, int]) -> None:
        """Record the files of the nodes that are read, with their numbers of points in the hierarchy."""
        self._found.append((tiles, counts))

    def with_crs(self, sources: Sequence[SourceInfo], notes: list[str]) -> list[SourceInfo]:
        """Return the sources, with the CRS of ``ept.json`` for nodes without one.

        Contradictions are appended to the notes.
        """
        whole = self._config.bounds is None and self._config.aoi is None
        known: dict[Path, Georeference] = {}
        for tiles, counts in self._found:
            notes += contradictions(tiles, counts, [s for s in sources if s.path in counts], whole)
            if tiles.wkt is not None:
                known |= dict.fromkeys(counts, describe(CRS.from_wkt(tiles.wkt)))
        sources_with_crs = []
        for source in sources:
            if source.georeference.kind == "missing" and source.path in known:
                source = replace(source, georeference=known[source.path])
            sources_with_crs.append(source)
        return sources_with_crs


def validate_distances(plan: Plan, inputs: Sequence[str]) -> None:
    """Raise ConfigError if a run needs points farther away than EPT nodes were considered."""
    reach_m = _reach_m(plan.config)
    if plan.area is None or not any(map(is_ept, inputs)):
        return
    if plan.margin > plan.meta.frame.counts(reach_m):
        raise ConfigError(
            f"--halo: nodes of ept.json are read up to {float(reach_m):g} m around the area, but this run needs points "
            "farther away; use a smaller --halo, or leave out --bounds"
        )


def _reach_m(config: RunConfig) -> Fraction:
    return NEAR_M + Fraction(config.max_edge) + Fraction(config.halo or 0)


def contradictions(
    tiles: EptDataset, counts: Mapping[Path, int], sources: Sequence[SourceInfo], whole: bool
) -> Iterator[str]:
    """Yield a line per kind of contradiction, with the first file that shows it.

    Parameters
    ----------
    tiles : EptDataset
    counts : mapping of Path to int
        Number of points of each requested file, from the hierarchy.
    sources : sequence of SourceInfo
        Files that could be read.
    whole : bool
        Whether all nodes were requested.
    """
    if whole:
        yield from tiles.other_total(sum(counts.values()))
    same: dict[str, bool] = {}
    kinds: tuple[Callable[[SourceInfo], Told], ...] = (
        lambda source: _points(counts, source),
        lambda source: _place(tiles, source),
        lambda source: _crs(tiles, source, same),
        lambda source: _scales(tiles, source),
        lambda source: _colours(tiles, source),
    )
    for told in kinds:
        faults = []
        for source in sources:
            text = told(source)
            if text is not None:
                faults.append((source.path, text))
        if faults:
            path, text = faults[0]
            more = f" ({len(faults)} of {len(sources)} files)" if len(sources) > 1 else ""
            yield f"{tiles.text}: {text} in {path.name}{more}; the files are used; create it again"


def _points(counts: Mapping[Path, int], source: SourceInfo) -> Told:
    said = counts[source.path]
    if said == source.points:
        return None
    return f"its hierarchy lists {said} points, but there are {source.points}"


def _place(tiles: EptDataset, source: SourceInfo) -> Told:
    key = key_of(source.path)
    if source.bounds is None or key is None:
        return None
    x0, y0, _, x1, y1, _ = source.bounds
    west, south, east, north = tiles.box(key)
    if min(x0 - west, y0 - south, east - x1, north - y1) >= -_CARELESS:
        return None
    return (
        f"its bounds place the node in {west:.10g} {south:.10g} {east:.10g} {north:.10g}, "
        f"but points lie in {x0:.10g} {y0:.10g} {x1:.10g} {y1:.10g}"
    )


def _crs(tiles: EptDataset, source: SourceInfo, same: dict[str, bool]) -> Told:
    wkt = source.georeference.wkt
    if tiles.wkt is None or wkt is None:
        return None
    if wkt not in same:
        file_crs, _ = split(CRS.from_wkt(wkt))
        said, _ = split(CRS.from_wkt(tiles.wkt))
        same[wkt] = file_crs is None or said is None or same_horizontal(said, file_crs)
    if same[wkt]:
        return None
    return f"its srs is {CRS.from_wkt(tiles.wkt).name}, but the CRS is {source.georeference.name}"


def _scales(tiles: EptDataset, source: SourceInfo) -> Told:
    if tiles.scales in (None, source.scales):
        return None
    return f"its schema has scales {tiles.scales}, but they are {source.scales}"


def _colours(tiles: EptDataset, source: SourceInfo) -> Told:
    if tiles.has_rgb in (None, source.has_rgb):
        return None
    if tiles.has_rgb:
        return "its schema has colours, but there are none"
    return "its schema has no colours, but there are some"
