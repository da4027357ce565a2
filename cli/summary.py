"""The few lines at the end of a job, from its summary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tiler.core.products import PRODUCTS
from tiler.io.locations import joined
from tiler.observe.progress import duration_text, rate_text, size_text

_RASTERS = {f"{name}.{kind}": place for place, name in enumerate(PRODUCTS) for kind in ("tif", "vrt")}
"""Names of the products' files, and their order."""


def percent_text(fraction: float | None) -> str:
    """A fraction in percent; ``-`` where there is none."""
    return "-" if fraction is None else f"{100 * fraction:.2f} %"


def summary_lines(summary: Mapping[str, Any], out: str, did_nothing: bool = False) -> list[str]:
    """What a job did, as people read it.

    Parameters
    ----------
    summary : mapping
        The content of ``run.json``; a job up to an early stage has not all of it.
    out : str
        Folder of the results.
    did_nothing : bool
        Everything had been done before.
    """
    points = summary["counts"]["stored"]
    lines = ["nothing to do: everything was done before"] if did_nothing else []
    files, dropped = len(summary["inputs"]), sum(summary["counts"]["dropped"].values())
    lost = f", {dropped:,} dropped" if dropped else ""
    lines.append(f"points      {points:,} of {files:,} file{'' if files == 1 else 's'}{lost}")
    if "filter" in summary:
        facts = summary["filter"]
        marked = f", {facts['marked']:,} labels not certified" if facts["marked"] else ""
        lines.append(f"ground      {facts['ground']:,} points, in {facts['tiles']:,} tiles{marked}")
    rasters = sorted(_RASTERS.keys() & summary.get("outputs", {}), key=_RASTERS.__getitem__)
    for name in rasters[:1]:
        facts = summary["dtm"]
        size = f"{facts['width']:,} x {facts['height']:,} pixels of {facts['resolution_m']:g} m"
        lines.append(f"{name.split('.')[0].upper():12s}{joined(out, name)}, {size}")
    if rasters[1:]:
        lines.append(f"products    {', '.join(joined(out, name) for name in rasters[1:])}")
    if summary.get("report"):
        lines.append(f"report      {joined(out, summary['report'])}")
    rate = "" if did_nothing else f", {rate_text(points, summary['seconds'])}"
    lines.append(f"time        {duration_text(summary['seconds'])}{rate}")
    lines.append(f"memory      {size_text(summary['peak_rss_bytes'])} at most in one process")
    for path, error in ((q["path"], q["error"]) for q in summary["quarantined"]):
        lines.append(f"left out    {path}: {error.removeprefix(f'{path}: ')}")  # most begin with it
    return [*lines, *failed_lines(summary["failed_tasks"])]


def failed_lines(failed: Sequence[Mapping[str, Any]]) -> list[str]:
    """The tasks that failed, as run.json lists them, and where each leaves a hole."""
    return [
        f"failed      {f.get('title', f['stage'])} {f['key']}{_place(f.get('bounds'))}: {f['error']}"
        for f in failed
    ]


def _place(bounds: Sequence[float] | None) -> str:
    return "" if bounds is None else f" (--bounds {' '.join(f'{edge:.10g}' for edge in bounds)})"


def score_lines(classes: Mapping[str, Any], dtm: Mapping[str, Any] | None = None) -> list[str]:
    """Errors of the classes, and of the DTM where its truth is known.

    Parameters
    ----------
    classes : mapping
        As `tiler.apps.evaluate.scores` gives them; what `tiler.apps.evaluate.evaluate_scenes` adds is told as well.
    dtm : mapping, optional
        As `tiler.apps.evaluate.evaluate_dtm` gives them.
    """
    kappa = percent_text(classes["kappa"])
    f1 = f", F1 {percent_text(classes['f1'])}" if "f1" in classes else ""
    lines = [
        f"type I  {percent_text(classes['type_1'])}  (ground lost)",
        f"type II {percent_text(classes['type_2'])}  (objects taken for ground)",
        f"total   {percent_text(classes['total'])}  of {classes['points']:,} points, kappa {kappa}{f1}",
    ]
    if classes["ignored"]:
        each = ", ".join(f"{code}: {n:,}" for code, n in classes.get("left_out", {}).items())
        of = f" (class {each})" if each else ""
        lines.append(f"ignored {classes['ignored']:,} points of the classes left out{of}")
    if classes.get("withheld"):
        lines.append(f"ignored {classes['withheld']:,} points that the reference withholds")
    unmatched = classes.get("unmatched_reference", 0), classes.get("unmatched_cloud", 0)
    if any(unmatched):
        lines.append(
            f"without a partner: {unmatched[0]:,} points of the reference, {unmatched[1]:,} of the cloud"
        )
    if dtm is not None:
        lines.extend(dtm_lines(dtm))
    return lines


def dtm_lines(dtm: Mapping[str, Any]) -> list[str]:
    """Differences of a DTM from its truth, as `tiler.apps.evaluate.evaluate_dtm` gives them."""
    unit = {"metre": "m", "foot": "ft"}.get(dtm["unit"], dtm["unit"])
    if dtm["rmse"] is None:
        return ["DTM     no pixel has both heights"]
    first = (
        f"DTM     RMSE {dtm['rmse']:.3f} {unit}, bias {dtm['bias']:+.3f} {unit} over {dtm['pixels']:,} pixels"
    )
    if "nmad" not in dtm:
        return [first]
    robust = f"median {dtm['median']:+.3f} {unit}, NMAD {dtm['nmad']:.3f} {unit}"
    return [
        first,
        f"        {robust}, 95 % within {dtm['p95_abs']:.3f} {unit}",
        f"        {percent_text(dtm['coverage'])} of the true pixels covered, {dtm['only_truth']:,} are not",
    ]
