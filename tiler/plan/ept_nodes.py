"""Inputs that are Entwine Point Tiles (EPT): nodes that a run may need, and their CRS.

If ``ept.json`` contradicts the files of its nodes, the values in the files are used and a note
reports it.
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
from tiler.core.lattice import COUNTS_PER_UNIT
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

_TOLERANCE = 1.0
"""Distance, in units of the CRS, by which points may lie outside their node: some writers round
inaccurately."""

Contradiction = str | None
"""Text about a contradiction, or None if there is none."""

NEAR_M = 1000
"""Distance in metres around the area within which nodes are read, in addition to ``--max-edge`` and ``--halo``.

The plan reduces the selection once the margin of the method is known.
"""


@dataclass(frozen=True)
class Near:
    """Predicate for boxes within ``margin`` counts of an area."""

    area: Area
    margin: int

    def __call__(self, box: tuple[float, float, float, float]) -> bool:
        """Return whether a box in units of the CRS lies near the area."""
        return self.area.touches(bounds_in_counts(box).pad(self.margin))


class EptInputs:
    """EPT data sets among the inputs of a run, with the nodes that are read."""

    def __init__(self, config: RunConfig) -> None:
        self._config = config
        self._selected: list[tuple[EptDataset, dict[Path, int]]] = []

    def node_filter(self, tiles: EptDataset) -> Near | None:
        """Return a predicate for nodes near the area of the run, or None if there is no area."""
        area = area_of(self._config, tiles.wkt, [])
        if area is None:
            return None
        unit = None
        if tiles.wkt is not None:
            unit = describe(CRS.from_wkt(tiles.wkt)).horizontal
        return Near(area, math.ceil(_margin_m(self._config) / (unit or 1) * COUNTS_PER_UNIT))

    def record(self, tiles: EptDataset, counts: dict[Path, int]) -> None:
        """Record the files of the nodes that are read, with their numbers of points in the hierarchy."""
        self._selected.append((tiles, counts))

    def with_crs(self, sources: Sequence[SourceInfo], notes: list[str]) -> list[SourceInfo]:
        """Return the sources, with the CRS of ``ept.json`` for nodes without one.

        Contradictions are appended to the notes.
        """
        all_nodes = self._config.bounds is None and self._config.aoi is None
        known: dict[Path, Georeference] = {}
        for tiles, counts in self._selected:
            notes += contradictions(
                tiles, counts, [s for s in sources if s.path in counts], all_nodes
            )
            if tiles.wkt is not None:
                known |= dict.fromkeys(counts, describe(CRS.from_wkt(tiles.wkt)))
        sources_with_crs = []
        for source in sources:
            if source.georeference.kind == "missing" and source.path in known:
                source = replace(source, georeference=known[source.path])
            sources_with_crs.append(source)
        return sources_with_crs


def validate_distances(plan: Plan, inputs: Sequence[str]) -> None:
    """Raise ConfigError if a run needs points farther from the area than EPT nodes were read."""
    margin_m = _margin_m(plan.config)
    if plan.inputs.area is None or not any(map(is_ept, inputs)):
        return
    if plan.margin > plan.frame.counts(margin_m):
        raise ConfigError(
            f"--halo: nodes of ept.json are read up to {float(margin_m):g} m around the area, but this run needs "
            "points farther away; use a smaller --halo, or leave out --bounds"
        )


def _margin_m(config: RunConfig) -> Fraction:
    return NEAR_M + Fraction(config.max_edge) + Fraction(config.halo or 0)


def contradictions(
    tiles: EptDataset,
    counts: Mapping[Path, int],
    sources: Sequence[SourceInfo],
    all_nodes: bool,
) -> Iterator[str]:
    """Yield a line per kind of contradiction, with the first file that shows it.

    Parameters
    ----------
    tiles : EptDataset
    counts : mapping of Path to int
        Number of points of each requested file, from the hierarchy.
    sources : sequence of SourceInfo
        Files that could be read.
    all_nodes : bool
        Whether all nodes were requested.
    """
    if all_nodes:
        yield from tiles.other_total(sum(counts.values()))
    same_crs: dict[str, bool] = {}
    checks: tuple[Callable[[SourceInfo], Contradiction], ...] = (
        lambda source: _check_points(counts, source),
        lambda source: _check_bounds(tiles, source),
        lambda source: _check_crs(tiles, source, same_crs),
        lambda source: _check_scales(tiles, source),
        lambda source: _check_colours(tiles, source),
    )
    for check in checks:
        faults = []
        for source in sources:
            text = check(source)
            if text is not None:
                faults.append((source.path, text))
        if faults:
            path, text = faults[0]
            more = f" ({len(faults)} of {len(sources)} files)" if len(sources) > 1 else ""
            yield f"{tiles.text}: {text} in {path.name}{more}; the values in the files are used; create ept.json again"


def _check_points(counts: Mapping[Path, int], source: SourceInfo) -> Contradiction:
    listed = counts[source.path]
    if listed == source.points:
        return None
    return f"its hierarchy lists {listed} points, but there are {source.points}"


def _check_bounds(tiles: EptDataset, source: SourceInfo) -> Contradiction:
    key = key_of(source.path)
    if source.bounds is None or key is None:
        return None
    x0, y0, _, x1, y1, _ = source.bounds
    west, south, east, north = tiles.box(key)
    if min(x0 - west, y0 - south, east - x1, north - y1) >= -_TOLERANCE:
        return None
    return (
        f"its bounds place the node in {west:.10g} {south:.10g} {east:.10g} {north:.10g}, "
        f"but points lie in {x0:.10g} {y0:.10g} {x1:.10g} {y1:.10g}"
    )


def _check_crs(
    tiles: EptDataset, source: SourceInfo, same_crs: dict[str, bool]
) -> Contradiction:
    """Compare the CRS of a file with that of ``ept.json``. ``same_crs`` keeps the results by the WKT of files."""
    wkt = source.georeference.wkt
    if tiles.wkt is None or wkt is None:
        return None
    if wkt not in same_crs:
        file_crs, _ = split(CRS.from_wkt(wkt))
        ept_crs, _ = split(CRS.from_wkt(tiles.wkt))
        same_crs[wkt] = (
            file_crs is None or ept_crs is None or same_horizontal(ept_crs, file_crs)
        )
    if same_crs[wkt]:
        return None
    return (
        f"its srs is {CRS.from_wkt(tiles.wkt).name}, but the CRS is {source.georeference.name}"
    )


def _check_scales(tiles: EptDataset, source: SourceInfo) -> Contradiction:
    if tiles.scales in (None, source.scales):
        return None
    return f"its schema has scales {tiles.scales}, but they are {source.scales}"


def _check_colours(tiles: EptDataset, source: SourceInfo) -> Contradiction:
    if tiles.has_rgb in (None, source.has_rgb):
        return None
    if tiles.has_rgb:
        return "its schema has colours, but there are none"
    return "its schema has no colours, but there are some"
