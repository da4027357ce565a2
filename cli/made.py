"""Lines about the results of a run with their counts and paths, printed at the end of a job."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from tiler.core.units_text import length_text
from tiler.core.words import counted
from tiler.io.locations import joined
from tiler.io.result_folder import BRIDGES, CLASSIFIED, OUTLINE, SHEETS, VIRTUAL, WATER

MAX_EDITS = 10
"""Largest number of edits that are printed, one per line."""

Summary = Mapping[str, Any]


def made_lines(summary: Summary, out: str) -> Iterator[str]:
    """Yield a line for each result that is not a raster, and for the effect of each edit.

    The line of a result has its name, count and path.

    Parameters
    ----------
    summary : mapping
        Content of run.json.
    out : str
        Folder of the results.
    """
    from tiler.report.drawn import changed_text  # needs libraries that `tiler --help` does not

    for name, text, file in _results(summary):
        written = file is None or file in summary.get("outputs", {}) or file == CLASSIFIED
        path_text = f", {joined(out, file)}" if file and written else ""
        yield f"{name:12s}{text}{path_text}"
    edits = summary.get("edits") or ()
    for edit in edits[:MAX_EDITS]:
        yield f"edit        {edit['number']} ({edit['action']}): {changed_text(edit)}"
    if len(edits) > MAX_EDITS:
        yield f"edits       {len(edits) - MAX_EDITS:,} more, in the report"


def _results(summary: Summary) -> Iterator[tuple[str, str, str | None]]:
    """Yield name, count and file of each result."""
    unit = summary.get("plan", {}).get("metres_per_unit", {}).get("vertical", 1.0)
    if contours := summary.get("contours"):
        interval = length_text(contours["interval"] * unit, unit)
        lines = f"{counted(contours['lines'], 'line')} every {interval}"
        yield "contours", lines, "contours.gpkg"
    if spots := summary.get("spots"):
        yield (
            "spots",
            f"{counted(spots['highs'], 'top')}, {counted(spots['lows'], 'bottom')}",
            "spots.gpkg",
        )
    if "water" in summary:
        yield "water", _water(summary["water"]), WATER
    if "bridges" in summary:
        number = len(summary["bridges"])
        yield (
            "bridges",
            f"{counted(number, 'bridge')} left out" if number else "none found",
            BRIDGES,
        )
    if polygons := (summary.get("outline") or {}).get("polygons"):
        yield "outline", counted(polygons, "polygon"), OUTLINE
    outputs = summary.get("outputs", {})
    clouds = sum(path.startswith(f"{CLASSIFIED}/") for path in outputs)
    if clouds:
        yield (
            "clouds",
            counted(clouds, "classified cloud"),
            VIRTUAL if VIRTUAL in outputs else CLASSIFIED,
        )
    if "sheets" in summary:
        yield "sheets", counted(summary["sheets"], "sheet"), SHEETS


def _water(bodies: Sequence[Mapping[str, Any]]) -> str:
    """Return the number of water bodies by kind, as in ``1 lake, 2 rivers``."""
    kinds = Counter(body["kind"] for body in bodies)
    return (
        ", ".join(counted(number, kind) for kind, number in sorted(kinds.items()))
        or "none found"
    )


def ground_points(summary: Summary) -> int:
    """Return the number of points that the run classified as ground, after the edits.

    If no classified clouds were written, it is the number that the filter found.
    """
    points: int = summary.get("classes", {}).get("ground", summary["filter"]["ground"])
    return points
