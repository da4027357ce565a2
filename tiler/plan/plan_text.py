"""The plan as text and as JSON."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Iterable
from typing import Any

from ptd.matched.survey import in_words
from tiler.core.crs import at_degrees, vertical_name
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.units import length_text, short_unit, unit_label
from tiler.core.words import counted, name_in_wkt
from tiler.io.locations import with_slashes
from tiler.plan.estimates import overlap_of, projected_disk, projected_memory, projected_seconds
from tiler.plan.method import KIND_WORDS, PlannedPass, steps_of
from tiler.plan.model import Plan
from tiler.plan.sizes import middle

WIDTH = 120
"""Maximum length of a line of the plan, in characters."""
INDENT = " " * 12
"""Beginning of a line that continues the line above."""


def plan_json(plan: Plan) -> dict[str, Any]:
    """Return the plan as JSON-able values."""
    inputs, grid, method, disk = plan.inputs, plan.grid, plan.method, projected_disk(plan)
    frame, units = grid.meta.frame, grid.meta.frame.units
    seconds, measured = projected_seconds(plan)
    return {
        "inputs": len(inputs.sources), "points": inputs.points,
        "unreadable": [[with_slashes(path), why] for path, why in inputs.left_out],
        "area_m2": inputs.covered_m2, "density_per_m2": inputs.density, "crs": frame.crs_wkt,
        "units": {"horizontal": unit_label(units.horizontal), "vertical": unit_label(units.vertical)},
        "units_from": _units_from(plan),
        "metres_per_unit": {"horizontal": float(units.horizontal), "vertical": float(units.vertical)},
        "area": _area_facts(plan), "extent": [v / COUNTS_PER_UNIT for v in inputs.extent.to_json()],
        "method": plan.config.method, "parameters": method.parameters, "passes": len(method.steps),
        "kind": method.kind,
        "kind_sure": plan.finding and plan.finding.sure, "kind_why": plan.finding and plan.finding.why,
        "halos_m": {step.name: step.halo_m for step in method.steps},
        "resolution_m": float(grid.resolution), "tile_m": float(method.tile), "bucket_m": grid.bucket_m,
        "halo_m": method.halo_m, "tiles": plan.tiles, "overlap_work": overlap_of(plan, method.steps),
        "halo_by_kind_m": {kind: method.halo_of(kind) for kind in method.kinds},
        "fullest_window_points": plan.max_window_points(), "workers": plan.resources.workers,
        "memory_bytes": plan.resources.memory,
        "projected_memory_bytes": projected_memory(plan), "projected_disk_bytes": sum(disk.values()),
        "disk_bytes": disk, "projected_seconds": seconds, "rates_of_this_machine": measured,
        "notes": list(plan.notes), "warnings": list(plan.warnings),
    }  # fmt: skip


def _units_from(plan: Plan) -> str:
    """Return what defines the units, unless the user gave them."""
    files = [source.georeference for source in plan.inputs.sources if source.points]
    wkt = plan.frame.crs_wkt
    if all(crs.horizontal is None for crs in files) and wkt is None:
        return "assumed, because the files have no CRS"
    by = "--crs" if all(crs.horizontal is None for crs in files) else "the files"
    if any(crs.vertical for crs in files) or (wkt is not None and vertical_name(wkt)):
        return f"declared by {by}"
    return f"declared by {by} for x and y, assumed to be the same for heights"


def plan_lines(plan: Plan) -> list[str]:
    """Return the plan as lines of text."""
    inputs, method, units = plan.inputs, plan.method, plan.frame.units
    unit, wkt = units.horizontal, plan.frame.crs_wkt
    west, south = inputs.extent.x0 / COUNTS_PER_UNIT, inputs.extent.y0 / COUNTS_PER_UNIT
    width_m, height_m = plan.sides_m
    lines = [
        f"inputs      {counted(len(inputs.sources), 'file')}, {counted(inputs.points, 'point')}, "
        f"{inputs.density:.3g} per m2 (by the headers, with duplicates, withheld points and noise)",
        f"extent      {width_m / float(unit):,.0f} x {height_m / float(unit):,.0f} {short_unit(unit)} from "
        f"({west:,.1f}, {south:,.1f})",
        f"CRS         {name_in_wkt(wkt, 'unknown')}{at_degrees(wkt, *middle(inputs.extent))}; "
        f"x, y in {unit_label(unit)}, z in {unit_label(units.vertical)}",
        *([] if plan.finding is None else [f"made by     {in_words(plan.finding)}"]),
        f"method      {plan.config.method}" + _passes_in_words(plan),
        f"DTM         pixels of {length_text(plan.grid.resolution, unit)}, "
        f"nodata beyond facets of {length_text(plan.config.max_edge, unit)}",
        f"products    {', '.join(plan.config.products)}",
        *_drawn_in_words(plan),
        f"tiles       about {plan.tiles} of {length_text(method.tile, unit)} with {_halo_in_words(plan)}, "
        f"about {plan.max_window_points():,} points in the fullest window"
        + (
            "; larger tiles for passes on one point per cell"
            if any(map(plan.joins, method.steps))
            else ""
        ),
        *_resources_in_words(plan),
    ]
    lines += [f"note        {text}" for text in plan.notes]
    lines += [f"warning     {text}" for text in plan.warnings]
    # These lines are not wrapped, so that the paths can be copied.
    left_out = [
        f"left out    {path}: {reason.removeprefix(f'{path}: ')}"
        for path, reason in inputs.left_out
    ]
    return [*itertools.chain.from_iterable(map(wrapped, lines)), *left_out]


def _resources_in_words(plan: Plan) -> list[str]:
    memory, disk = projected_memory(plan), projected_disk(plan)
    largest = max(memory, key=lambda stage: memory[stage])
    seconds, measured = projected_seconds(plan)
    return [
        "memory      "
        + ", ".join(f"{stage} {size / 2**20:,.0f}" for stage, size in memory.items() if size)
        + f" MiB: a worker needs {memory[largest] / 2**20:,.0f} MiB at most ({largest}), "
        f"{plan.resources.memory / 2**20:,.0f} MiB allowed, {plan.resources.workers} workers",
        f"disk        about {sum(disk.values()) / 1e9:.2f} GB: "
        + ", ".join(f"{name} {size / 1e9:.2f}" for name, size in disk.items() if size),
        f"time        about {seconds:,.0f} s, plus start-up"
        + (
            ""
            if measured
            else " (with rates of another machine for stages without an earlier run here)"
        ),
    ]


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
    inputs = plan.inputs
    counts = {
        "edit": len(inputs.edits),
        "breakline": len(inputs.lines),
        "water polygon": len(inputs.waters),
    }
    parts = [f"{n:,} {name}{'' if n == 1 else 's'}" for name, n in counts.items() if n]
    return [f"drawn       {', '.join(parts)}"] if parts else []


def _area_facts(plan: Plan) -> dict[str, Any] | None:
    """Return the area of interest as JSON-able values, or None if the whole survey is processed."""
    if plan.inputs.area is None:
        return None
    return {
        "file": plan.config.aoi,
        "polygons": len(plan.inputs.area.polygons),
        "bounds": [v / COUNTS_PER_UNIT for v in plan.inputs.area.bounds.to_json()],
        "margin_m": float(plan.margin / COUNTS_PER_UNIT * plan.frame.units.horizontal),
    }


def _halo_in_words(plan: Plan) -> str:
    """Describe the widest halo and its work, for each possible kind if the kind is not known."""
    unit = plan.frame.units.horizontal

    def words(halo_m: float, steps: Iterable[PlannedPass]) -> str:
        return f"{length_text(halo_m, unit)} of halo ({overlap_of(plan, steps):.2f} times the work)"

    if not plan.method.kinds:
        return words(plan.method.halo_m, plan.method.steps)
    halos_text = ", or ".join(
        f"{words(plan.method.halo_of(kind), steps_of(plan.method.passes, kind))} for {KIND_WORDS[kind]}"
        for kind in plan.method.kinds
    )
    return f"{halos_text}, decided from the points (or give --kind)"


def _passes_in_words(plan: Plan) -> str:
    """Describe the number of passes and, if there are several, the halo of each."""
    steps = plan.method.steps
    if len(steps) < 2:
        return ", 1 pass" if steps else ""
    text = f", {len(steps)} passes"
    if any(step.sometimes and (step.kind is None or plan.method.kinds) for step in steps):
        text += ", some of them only for some clouds"
    unit = plan.frame.units.horizontal
    halos = [f"{step.title} (halo {length_text(step.halo_m, unit)})" for step in steps]
    return f"{text}: {', '.join(halos)}"
