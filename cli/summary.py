"""Lines printed at the end of a job, made from its summary: results with counts and paths, and what failed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiler.core.units import length_text
from tiler.core.words import counted
from tiler.io.locations import joined
from tiler.io.result_folder import (
    BRIDGES,
    CHANGED,
    CLASSIFIED,
    OUTLINE,
    REPORT,
    REVIEW,
    SHEETS,
    VIRTUAL,
    WATER,
    written_rasters,
)
from tiler.observe.progress import duration_text, rate_text, size_text

if TYPE_CHECKING:
    from tiler.runs.job import RunResult

MAX_OF_KIND = 3
"""Number of lines about files that were left out, or about failed tasks."""


def percent_text(fraction: float | None) -> str:
    """Return a fraction in percent, or ``-`` for None."""
    return "-" if fraction is None else f"{100 * fraction:.2f} %"


def run_lines(results: Sequence[RunResult], out: str) -> list[str]:
    """Return lines about the results of a run, for each resolution if it has several."""
    if len(results) == 1:
        return summary_lines(results[0].summary, out, results[0].did_nothing)
    lines = []
    for result in results:
        folder = joined(out, Path(result.out).name)
        lines += [f"resolution  {folder}"]
        lines += summary_lines(result.summary, folder, result.did_nothing)
    return [*lines, f"all         {joined(out, REPORT)}"]


def summary_lines(summary: Mapping[str, Any], out: str, did_nothing: bool = False) -> list[str]:
    """Return lines about the results of a job.

    Parameters
    ----------
    summary : mapping
        Content of ``run.json``. After a job that ended after an early stage, some of it is missing.
    out : str
        Folder of the results.
    did_nothing : bool
        Whether all results were up to date.
    """
    # Modules of the report load libraries, and `tiler --help` must be fast.
    from tiler.report.problems import kinds_text
    from tiler.report.sections import share_with_height, surveyed_text
    from tiler.report.tables import COUNTED

    points = summary["counts"]["stored"]
    lines = ["nothing to do: all results are up to date"] if did_nothing else []
    files, dropped = len(summary["inputs"]), sum(summary["counts"]["dropped"].values())
    lost = f", {dropped:,} dropped" if dropped else ""
    for name in ("duplicates_within_files", "duplicates_between_files"):
        if repeats := summary["counts"].get(name):
            lost += (
                f", {counted(repeats, 'duplicate')}{COUNTED[name].removeprefix('duplicates')}"
            )
    lines.append(f"points      {points:,} of {counted(files, 'file')}{lost}")
    stages = list(summary.get("stages", {}).values())
    if not did_nothing and (kept := sum(stage["done"] for stage in stages)):
        all_tasks = counted(sum(stage["tasks"] for stage in stages), "task")
        lines.append(f"kept        {kept:,} of {all_tasks}, which earlier runs did")
    if "filter" in summary:
        section = summary["filter"]
        marked = f", {section['marked']:,} labels not certified" if section["marked"] else ""
        tiles = counted(section["tiles"], "tile")
        # after the edits; without classified clouds, the number that the filter found
        ground = summary.get("classes", {}).get("ground", section["ground"])
        lines.append(f"ground      {counted(ground, 'point')}, in {tiles}{marked}")
        if section["low_noise"]:
            lines.append(
                f"low noise   {counted(section['low_noise'], 'point')} below the ground"
            )
    unit = summary.get("plan", {}).get("metres_per_unit", {}).get("horizontal", 1.0)
    rasters = list(written_rasters(summary).items())
    for product, file in rasters[:1]:
        section = summary["dtm"]
        pixel = length_text(section["resolution_m"], unit)
        # The VRT of the sheets covers whole sheets.
        cut = "sheets cut from " if summary.get("sheets") else ""
        size = f"{cut}{section['width']:,} x {section['height']:,} pixels of {pixel}"
        if "voids" in summary:
            share = share_with_height(summary["voids"])
            size += f", {share} of {surveyed_text(summary)} has a height"
        lines.append(f"{product.upper():12s}{joined(out, file)}, {size}")
    if rasters[1:]:
        lines.append(f"products    {', '.join(joined(out, file) for _, file in rasters[1:])}")
    lines.extend(_made_lines(summary, out))
    if problems := summary.get("problems"):
        lines.append(f"problems    {kinds_text(problems)}")
    if summary.get("report"):
        lines.append(f"report      {joined(out, summary['report'])}")
    rate = "" if did_nothing else f", {rate_text(points, summary['seconds'])}"
    lines += [
        f"time        {duration_text(summary['seconds'])}{rate}",
        f"memory      {memory_text(summary['peak_rss_bytes'])}",
    ]
    left_out = left_out_lines(summary["quarantined"])
    return [*lines, *_first(left_out), *_first(failed_lines(summary["failed_tasks"]))]


def memory_text(peak_bytes: float) -> str:
    """Return the peak memory of a run as text."""
    return f"{size_text(peak_bytes)} at most in one process"


def left_out_lines(files: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return one line per file of run.json that was left out."""
    return [
        f"left out    {path}: {error.removeprefix(f'{path}: ')}"  # most errors begin with the path
        for path, error in ((f["path"], f["error"]) for f in files)
    ]


def _first(lines: Sequence[str]) -> list[str]:
    """Return the first lines of a kind, and their first word with the number of the others."""
    more = len(lines) - MAX_OF_KIND
    if more <= 0:
        return list(lines)
    return [*lines[:MAX_OF_KIND], f"{lines[0][:12]}{more} more, listed in run.json"]


AGREEMENT = {"kappa": "kappa", "f1": "F1", "iou": "IoU", "mcc": "MCC"}
"""Measures of the agreement of classes, and their names. IoU is that of ground, MCC the coefficient of Matthews."""


def failed_lines(failed: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return one line per failed task of run.json, with the bounds of the gap that it leaves."""
    return [
        f"failed      {f.get('title', f['stage'])} {f['key']}{_place(f.get('bounds'))}: {f['error']}"
        for f in failed
    ]


def _place(bounds: Sequence[float] | None) -> str:
    return (
        "" if bounds is None else f" (--bounds {' '.join(f'{edge:.10g}' for edge in bounds)})"
    )


def score_lines(classes: Mapping[str, Any], dtm: Mapping[str, Any] | None = None) -> list[str]:
    """Return lines with the errors of the classes, and of the DTM if its reference is known.

    Parameters
    ----------
    classes : mapping
        Scores of `tiler.apps.evaluate.scores`, or the scores and further facts of
        `tiler.apps.evaluate.evaluate_scenes`.
    dtm : mapping, optional
        Errors of `tiler.apps.evaluate.evaluate_dtm`.
    """
    agreement = ", ".join(
        f"{title} {percent_text(classes[name])}"
        for name, title in AGREEMENT.items()
        if name in classes
    )
    lines = [
        f"type I  {percent_text(classes['type_1'])}  (ground lost)",
        f"type II {percent_text(classes['type_2'])}  (objects classified as ground)",
        f"total   {percent_text(classes['total'])}  of {classes['points']:,} points, {agreement}",
    ]
    if classes["ignored"]:
        each = ", ".join(f"{code}: {n:,}" for code, n in classes.get("left_out", {}).items())
        of = f" (class {each})" if each else ""
        lines.append(f"ignored {classes['ignored']:,} points of ignored classes{of}")
    if classes.get("withheld"):
        lines.append(
            f"ignored {classes['withheld']:,} points that are withheld in the reference"
        )
    unmatched = classes.get("unmatched_reference", 0), classes.get("unmatched_cloud", 0)
    if any(unmatched):
        lines.append(
            f"without a partner: {unmatched[0]:,} points of the reference, {unmatched[1]:,} of the cloud"
        )
    if dtm is not None:
        lines.extend(dtm_lines(dtm))
    return lines


def dtm_lines(dtm: Mapping[str, Any]) -> list[str]:
    """Return lines with the differences of a DTM from its reference, as measured by `evaluate_dtm`."""
    unit = {"metre": "m", "foot": "ft"}.get(dtm["unit"], dtm["unit"])
    if dtm["rmse"] is None:
        return ["DTM     no pixel has a height in both rasters"]
    first = f"DTM     RMSE {dtm['rmse']:.3f} {unit}, bias {dtm['bias']:+.3f} {unit} over {dtm['pixels']:,} pixels"
    if "nmad" not in dtm:
        return [first]
    robust = f"median {dtm['median']:+.3f} {unit}, NMAD {dtm['nmad']:.3f} {unit}"
    return [
        first,
        f"        {robust}, 95 % within {dtm['p95_abs']:.3f} {unit}",
        f"        {percent_text(dtm['coverage'])} of the reference pixels covered, {dtm['only_truth']:,} are not",
        *(sigma_lines(dtm["sigma"], unit) if "sigma" in dtm else ()),
    ]


def sigma_lines(found: Mapping[str, Any], unit: str) -> list[str]:
    """Return lines that compare standard errors with errors, from `tiler.apps.evaluate.heights.SigmaTally.summary`."""
    if not found["pixels"]:
        return ["sigma   no pixel has both a standard error and a reference height"]
    shares = ", ".join(percent_text(found[f"within_{k}"]) for k in (1, 2, 3))
    lines = [
        f"sigma   rule of thumb: RMSE {found['predicted_rmse']:.3f} {unit}, actual {found['rmse']:.3f} {unit}",
        f"        errors within 1, 2, 3 sigma: {shares}",
    ]
    for row in found["by_slope"]:
        if row["pixels"]:
            thumb, true = (f"{row[name]:.3f} {unit}" for name in ("predicted_rmse", "rmse"))
            where = f"slope {row['from_deg']} to {row['to_deg']} degrees"
            lines.append(
                f"        {where}: rule of thumb {thumb}, actual {true} over {row['pixels']:,} pixels"
            )
    if found["area"] is not None:
        share = percent_text(found["in_first_tenth"])
        lines.append(
            f"        the tenth of the pixels with the largest sigma has {share} of the squared error"
        )
        rank = f"{found['area']:.3f} (0.5: random; best possible: {found['area_at_best']:.3f})"
        lines.append(f"        ranking of the pixels by sigma: {rank}")
    return lines


MAX_EDITS = 10
"""Largest number of edits that are printed, one per line."""

Summary = Mapping[str, Any]


def _made_lines(summary: Summary, out: str) -> Iterator[str]:
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
        outputs = summary.get("outputs", {})
        written = file is None or file in outputs or file in (CLASSIFIED, CHANGED)
        path_text = f", {joined(out, file)}" if file and written else ""
        yield f"{name:12s}{text}{path_text}"
    edits = summary.get("edits") or ()
    for edit in edits[:MAX_EDITS]:
        yield f"edit        {edit['number']} ({edit['action']}): {changed_text(edit)}"
    if len(edits) > MAX_EDITS:
        yield f"edits       {len(edits) - MAX_EDITS:,} more, in the report"


def _results(summary: Summary) -> Iterator[tuple[str, str, str | None]]:
    from tiler.report.problems import review_text

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
    if (review := summary.get("review")) and any(review.values()):
        yield "review", review_text(review), REVIEW
    if "changes" in summary:
        changes = summary["changes"]
        number = len(changes["changed"]) + len(changes["added"])
        text = f"{counted(number, 'file')}, {changes['unchanged']:,} unchanged since the run before"
        yield "changed", text, CHANGED if number else None
    if "sheets" in summary:
        yield "sheets", counted(summary["sheets"], "sheet"), SHEETS


def _water(bodies: Sequence[Mapping[str, Any]]) -> str:
    """Return the number of water bodies by kind, as in ``1 lake, 2 rivers``."""
    kinds = Counter(body["kind"] for body in bodies)
    return (
        ", ".join(counted(number, kind) for kind, number in sorted(kinds.items()))
        or "none found"
    )
