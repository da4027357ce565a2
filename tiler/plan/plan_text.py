"""The plan as text and as JSON."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Iterable
from typing import Any

from ptd.matched.survey import in_words
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.units import unit_label
from tiler.core.units_text import length_text, short_unit
from tiler.core.words import counted
from tiler.plan.disk import projected_disk
from tiler.plan.memory import PlannedPass
from tiler.plan.model import Plan, steps_of
from tiler.plan.projection import overlap_of, projected_memory
from tiler.plan.rates import projected_seconds

WIDTH = 120
"""Maximum length of a line of the plan, in characters."""
INDENT = " " * 12
"""Beginning of a line that continues the line above."""

KIND_WORDS = {"lidar": "a LiDAR cloud", "dim": "a photogrammetric cloud"}


def plan_json(plan: Plan) -> dict[str, Any]:
    """Return the plan as JSON-able values."""
    frame, disk = plan.meta.frame, projected_disk(plan)
    seconds, measured = projected_seconds(plan)
    return {
        "inputs": len(plan.sources), "unreadable": [list(u) for u in plan.unreadable], "points": plan.points,
        "area_m2": plan.area_m2, "density_per_m2": plan.density, "crs": frame.crs_wkt,
        "units": {"horizontal": unit_label(frame.units.horizontal), "vertical": unit_label(frame.units.vertical)},
        "metres_per_unit": {"horizontal": float(frame.units.horizontal), "vertical": float(frame.units.vertical)},
        "area": _area_facts(plan), "extent": [v / COUNTS_PER_UNIT for v in plan.extent.to_json()],
        "method": plan.config.method, "parameters": plan.parameters, "passes": len(plan.steps), "kind": plan.kind,
        "kind_sure": plan.finding and plan.finding.sure, "kind_why": plan.finding and plan.finding.why,
        "halos_m": {step.name: step.halo_m for step in plan.steps},
        "resolution_m": float(plan.resolution), "tile_m": float(plan.tile), "bucket_m": plan.bucket_m,
        "halo_m": plan.halo_m, "tiles": plan.tiles, "overlap_work": overlap_of(plan, plan.steps),
        "halo_by_kind_m": {kind: plan.halo_of(kind) for kind in plan.kinds},
        "fullest_window_points": plan.max_window_points(), "workers": plan.workers, "memory_bytes": plan.memory,
        "projected_memory_bytes": projected_memory(plan), "projected_disk_bytes": sum(disk.values()),
        "disk_bytes": disk, "projected_seconds": seconds, "rates_of_this_machine": measured,
        "notes": list(plan.notes), "warnings": list(plan.warnings),
    }  # fmt: skip


def plan_lines(plan: Plan) -> list[str]:
    """Return the plan as lines of text."""
    frame, memory, disk = plan.meta.frame, projected_memory(plan), projected_disk(plan)
    largest = max(memory, key=lambda stage: memory[stage])
    west, south = plan.extent.x0 / COUNTS_PER_UNIT, plan.extent.y0 / COUNTS_PER_UNIT
    width_m, height_m = plan.sides_m
    seconds, measured = projected_seconds(plan)
    unit = frame.units.horizontal
    lines = [
        f"inputs      {counted(len(plan.sources), 'file')}, {counted(plan.points, 'point')}, {plan.density:.3g} per m2",
        f"extent      {width_m / float(unit):,.0f} x {height_m / float(unit):,.0f} {short_unit(unit)} from "
        f"({west:,.1f}, {south:,.1f})",
        f"CRS         {crs_name(frame.crs_wkt)}; x, y in {unit_label(frame.units.horizontal)}, "
        f"z in {unit_label(frame.units.vertical)}",
        *([] if plan.finding is None else [f"made by     {in_words(plan.finding)}"]),
        f"method      {plan.config.method}" + _passes_in_words(plan),
        f"DTM         pixels of {length_text(plan.resolution, unit)}, "
        f"nodata beyond facets of {length_text(plan.config.max_edge, unit)}",
        f"products    {', '.join(plan.config.products)}",
        *_drawn_in_words(plan),
        f"tiles       about {plan.tiles} of {length_text(plan.tile, unit)} with {_halo_in_words(plan)}, "
        f"about {plan.max_window_points():,} points in the fullest window"
        + ("; larger tiles for passes on one point per cell" if any(map(plan.joins, plan.steps)) else ""),
        "memory      "
        + ", ".join(f"{stage} {size / 2**20:,.0f}" for stage, size in memory.items() if size)
        + f" MiB: a worker needs {memory[largest] / 2**20:,.0f} MiB at most ({largest}), "
        f"{plan.memory / 2**20:,.0f} MiB allowed, {plan.workers} workers",
        f"disk        about {sum(disk.values()) / 1e9:.2f} GB: "
        + ", ".join(f"{name} {size / 1e9:.2f}" for name, size in disk.items() if size),
        f"time        about {seconds:,.0f} s, plus start-up"
        + ("" if measured else " (with rates of another machine for stages without an earlier run here)"),
    ]
    lines += [f"note        {text}" for text in plan.notes]
    lines += [f"warning     {text}" for text in plan.warnings]
    # These lines are not wrapped, so that the paths can be copied.
    left_out = [f"left out    {path}: {reason}" for path, reason in plan.unreadable]
    return [*itertools.chain.from_iterable(map(wrapped, lines)), *left_out]


def wrapped(line: str) -> list[str]:
    """Wrap a line of the plan to `WIDTH`, with indented continuation lines."""
    return textwrap.wrap(
        line,
        WIDTH,
        subsequent_indent=INDENT,
        break_long_words=False,
        break_on_hyphens=False,
        drop_whitespace=True,
    )


def _drawn_in_words(plan: Plan) -> list[str]:
    """Return the line on edits, breaklines and water drawn by the user, if there are any."""
    counts = {"edit": len(plan.edits), "breakline": len(plan.lines), "water polygon": len(plan.waters)}
    parts = [f"{n:,} {name}{'' if n == 1 else 's'}" for name, n in counts.items() if n]
    return [f"drawn       {', '.join(parts)}"] if parts else []


def _area_facts(plan: Plan) -> dict[str, Any] | None:
    """Return the area of interest as JSON-able values, or None if the whole survey is processed."""
    if plan.area is None:
        return None
    return {
        "file": plan.config.aoi,
        "polygons": len(plan.area.polygons),
        "bounds": [v / COUNTS_PER_UNIT for v in plan.area.bounds.to_json()],
        "margin_m": float(plan.margin / COUNTS_PER_UNIT * plan.meta.frame.units.horizontal),
    }


def _halo_in_words(plan: Plan) -> str:
    """Describe the widest halo and its work, for each possible kind if the kind is not known."""
    unit = plan.meta.frame.units.horizontal

    def words(halo_m: float, steps: Iterable[PlannedPass]) -> str:
        return f"{length_text(halo_m, unit)} of halo, overlap work {overlap_of(plan, steps):.2f}"

    if not plan.kinds:
        return words(plan.halo_m, plan.steps)
    halos_text = ", or ".join(
        f"{words(plan.halo_of(kind), steps_of(plan.passes, kind))} for {KIND_WORDS[kind]}"
        for kind in plan.kinds
    )
    return f"{halos_text}, decided from the points (or give --kind)"


def _passes_in_words(plan: Plan) -> str:
    """Describe the number of passes and, if there are several, the halo of each."""
    steps = plan.steps
    if len(steps) < 2:
        return ", 1 pass" if steps else ""
    text = f", {len(steps)} passes"
    if any(step.sometimes and (step.kind is None or plan.kinds) for step in steps):
        text += ", some of them only for some clouds"
    unit = plan.meta.frame.units.horizontal
    halos = [f"{step.title} (halo {length_text(step.halo_m, unit)})" for step in steps]
    return f"{text}: {', '.join(halos)}"


def crs_name(wkt: str | None) -> str:
    """Return the name of a CRS in WKT, or "unknown" if it is None."""
    if wkt is None:
        return "unknown"
    return wkt.split('"', 2)[1] if '"' in wkt else wkt
