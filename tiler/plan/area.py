"""Area of interest of a run (``--bounds`` or ``--aoi``), and the parts of the inputs read for it.

For Entwine Point Tiles (EPT), nodes near the area are selected. If ``ept.json`` contradicts the
files of its nodes, the values in the files are used and a note reports it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

from pyproj import CRS

from ptd.matched.evidence import DIM, LIDAR
from tiler.config import RunConfig
from tiler.core.area import Area, Runs
from tiler.core.crs import same_horizontal, split
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds
from tiler.core.units import length_text
from tiler.errors import ConfigError, InputError
from tiler.inputs import (
    EptDataset,
    Georeference,
    SourceInfo,
    bounds_in_counts,
    describe,
    header_bounds,
    is_ept,
    key_of,
)
from tiler.io.vector import CUT
from tiler.io.vector.reading import read_area
from tiler.plan.model import Plan
from tiler.plan.sizes import bounds_of
from tiler.schedule import call_isolated

NODE_TOLERANCE = 1.0
"""Distance, in units of the CRS, by which points may lie outside their node: some writers round
inaccurately."""

NEAR_M = 1000
"""Distance in metres around the area within which nodes are read, in addition to ``--max-edge`` and ``--halo``.

The plan reduces the selection once the margin of the method is known.
"""


def area_of(config: RunConfig, wkt: str | None, notes: list[str]) -> Area | None:
    """Return the area of interest in absolute counts, or None if the whole survey is processed.

    Parameters
    ----------
    config : RunConfig
    wkt : str or None
        CRS of the run; None if it is unknown.
    notes : list of str
        List to which notes on decisions are appended.

    Raises
    ------
    ConfigError
        Both settings are given, or the bounds are empty.
    InputError
        The file cannot be used because of its format, its CRS, or missing polygons.
    """
    if config.bounds is not None and config.aoi is not None:
        raise ConfigError(
            "--bounds and --aoi: both select a part of the survey; give only one of them"
        )
    if config.bounds is not None:
        bounds = bounds_in_counts(config.bounds)
        if bounds.empty:
            raise ConfigError(
                f"--bounds {' '.join(f'{v:g}' for v in config.bounds)} is empty; give larger bounds"
            )
        return Area.rectangle(bounds)
    if config.aoi is None:
        return None
    path = Path(config.aoi)
    if config.in_process:
        area, decided = read_area(path, wkt)
    else:
        area, decided = call_isolated(read_area, path, wkt, paths=(path,), smaller=CUT)
    notes += decided
    return area


def part_of(plan: Plan) -> Plan:
    """Return the plan reduced to the files near its area, with an estimate of their points there.

    Raises
    ------
    ConfigError
        No file lies near the area.
    InputError
        The octree of a file near the area is damaged, and the run stops on errors or no other file is left.
    """
    inputs, area = plan.inputs, plan.inputs.area
    if area is None:
        return plan
    option = "--bounds" if plan.config.aoi is None else f"--aoi {plan.config.aoi}"
    near = [
        s for s in inputs.sources if s.points and area.touches(bounds_of(s).pad(plan.margin))
    ]
    near, damaged = _without_damaged(plan, near, option)
    near = [s for s in near if chunks_of(plan, s) != []]  # None stands for all chunks.
    if not near or not area.touches(inputs.extent):
        west, south, east, north = (v / COUNTS_PER_UNIT for v in area.bounds.to_json())
        x0, y0, x1, y1 = (v / COUNTS_PER_UNIT for v in inputs.extent.to_json())
        raise ConfigError(
            f"{option}: ({west:.10g}, {south:.10g}) to ({east:.10g}, {north:.10g}) contains no part of the clouds, "
            f"which lie in ({x0:.10g}, {y0:.10g}) to ({x1:.10g}, {y1:.10g}); give an area there, in units of their CRS"
        )
    n_far = sum(bool(s.points) for s in inputs.sources) - len(near) - len(damaged)
    notes = [
        f"{option}: points within {_length(plan, plan.margin)} of it are read as well, so that its border is "
        f"not visible in the results{_narrower_margins(plan)}"
    ]
    if n_far:
        notes.append(f"{option}: {n_far} files lie farther away and are not read")
    shares = [_share(plan, source) for source in near]
    points = max(round(sum(s.points * share for s, share in zip(near, shares, strict=True))), 1)
    read = {source.path for source in near}
    part = replace(
        inputs,
        sources=tuple(near),
        left_out=(*inputs.left_out, *damaged),
        points=points,
        covered_m2=points / inputs.density,
        extent=inputs.extent.intersection(area.bounds),
        cloud_names={path: name for path, name in inputs.cloud_names.items() if path in read},
    )
    return replace(plan, inputs=part, notes=(*plan.notes, *notes))


def buckets_of(plan: Plan, source: SourceInfo) -> Runs | None:
    """Return the buckets for which points of a source are read, or None for all buckets."""
    if plan.inputs.area is None:
        return None
    extent = header_bounds(source)
    if extent is None:  # The header gives no valid bounds, so the points may be anywhere.
        extent = plan.inputs.area.bounds.pad(plan.margin)
    return plan.inputs.area.cells(plan.buckets, extent, plan.margin)


def chunks_of(plan: Plan, source: SourceInfo, margin: int | None = None) -> list[int] | None:
    """Return the chunks of a COPC file that may hold points near the area.

    None means that all chunks may, or that the file has another format.

    Parameters
    ----------
    plan : Plan
    source : SourceInfo
    margin : int, optional
        Distance around the area within which points are needed, in counts; the plan's by default.
    """
    if plan.inputs.area is None or source.octree is None or buckets_of(plan, source) is None:
        return None
    if margin is None:
        margin = plan.margin
    near = set()
    for key in set(source.octree.keys):
        if plan.inputs.area.touches(_around(source.octree.box(key)).pad(margin)):
            near.add(key)
    return [chunk for chunk, key in enumerate(source.octree.keys) if key in near]


def _around(box: Sequence[float]) -> Bounds:
    """Return a box in counts, widened by a unit of the CRS because some writers round inaccurately."""
    x0, y0 = (math.floor((v - 1) * COUNTS_PER_UNIT) for v in box[:2])
    x1, y1 = (math.ceil((v + 1) * COUNTS_PER_UNIT) for v in box[2:])
    return Bounds(x0, y0, x1, y1)


def _without_damaged(
    plan: Plan, sources: list[SourceInfo], option: str
) -> tuple[list[SourceInfo], list[tuple[str, str]]]:
    """Return the files without a damaged octree, and path and reason of each file with one."""
    remedy = f"get the file again, or run without {option.split()[0]}"
    damaged = [
        (str(s.path), f"{s.path}: {s.octree_damage}; {remedy}")
        for s in sources
        if s.octree_damage
    ]
    if damaged and (plan.config.on_error == "stop" or len(damaged) == len(sources)):
        raise InputError(damaged[0][1])
    return [s for s in sources if not s.octree_damage], damaged


def _narrower_margins(plan: Plan) -> str:
    """Return a text with the kinds of clouds that need a narrower margin, or "" if there are none."""
    # With --statistics, the earlier run decides the kind.
    if not plan.method.kinds or plan.method.statistics is not None:
        return ""
    texts = []
    for option, kind in (("als", LIDAR), ("dim", DIM)):
        margin = replace(plan, method=replace(plan.method, kind=kind)).margin
        if margin < plan.margin:
            texts.append(f" ({_length(plan, margin)} are enough with --kind {option})")
    return "".join(texts)


def _length(plan: Plan, counts: int) -> str:
    unit = plan.frame.units.horizontal
    return length_text(counts / COUNTS_PER_UNIT * float(unit), unit)


def _share(plan: Plan, source: SourceInfo) -> float:
    """Return the approximate share of a source's points that is read."""
    runs = buckets_of(plan, source)
    if runs is None:
        return 1.0
    cells = sum(end - first for _, first, end in runs)
    return min(cells * float(plan.buckets.size) ** 2 / bounds_of(source).area(), 1.0)


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
    compared = [_compare(tiles, counts[source.path], source, same_crs) for source in sources]
    for texts in zip(*compared, strict=True):
        faults = [(s.path, text) for s, text in zip(sources, texts, strict=True) if text]
        if faults:
            path, text = faults[0]
            more = f" ({len(faults)} of {len(sources)} files)" if len(sources) > 1 else ""
            yield f"{tiles.text}: {text} in {path.name}{more}; the values in the files are used; create ept.json again"


def _compare(
    tiles: EptDataset, n_listed: int, source: SourceInfo, same_crs: dict[str, bool]
) -> tuple[str, ...]:
    """Return a text for each kind of contradiction between ``ept.json`` and a file, empty if there is none.

    ``n_listed`` is the number of points in the hierarchy. ``same_crs`` keeps the results by the WKT of files.
    """
    points = bounds = crs = scales = colours = ""
    if n_listed != source.points:
        points = f"its hierarchy lists {n_listed} points, but there are {source.points}"
    key = key_of(source.path)
    if source.bounds is not None and key is not None:
        x0, y0, _, x1, y1, _ = source.bounds
        west, south, east, north = tiles.box(key)
        if not min(x0 - west, y0 - south, east - x1, north - y1) >= -NODE_TOLERANCE:
            bounds = (
                f"its bounds place the node in {west:.10g} {south:.10g} {east:.10g} {north:.10g}, "
                f"but points lie in {x0:.10g} {y0:.10g} {x1:.10g} {y1:.10g}"
            )
    wkt = source.georeference.wkt
    if tiles.wkt is not None and wkt is not None:
        if wkt not in same_crs:
            of_file, of_ept = (split(CRS.from_wkt(text))[0] for text in (wkt, tiles.wkt))
            same_crs[wkt] = (
                of_file is None or of_ept is None or same_horizontal(of_ept, of_file)
            )
        if not same_crs[wkt]:
            crs = f"its srs is {CRS.from_wkt(tiles.wkt).name}, but the CRS is {source.georeference.name}"
    if tiles.scales not in (None, source.scales):
        scales = f"its schema has scales {tiles.scales}, but they are {source.scales}"
    if tiles.has_rgb not in (None, source.has_rgb):
        colours = "its schema has no colours, but there are some"
        if tiles.has_rgb:
            colours = "its schema has colours, but there are none"
    return points, bounds, crs, scales, colours
