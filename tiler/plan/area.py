"""Area of interest of a run (``--bounds`` or ``--aoi``), and the parts of the inputs read for it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ptd.matched.evidence import DIM, LIDAR
from tiler.config import RunConfig
from tiler.core.area import Area, Runs
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds
from tiler.core.units import length_text
from tiler.errors import ConfigError, InputError
from tiler.inputs import SourceInfo, bounds_in_counts, header_bounds
from tiler.io.vector import CUT
from tiler.io.vector.reading import read_area
from tiler.plan.model import Plan
from tiler.plan.sizes import bounds_of
from tiler.schedule import call_isolated


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
