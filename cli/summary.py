"""The few lines at the end of a job, from its summary."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tiler.observe.progress import duration_text


def size_text(size: float) -> str:
    """A number of bytes: ``812.0 MiB``."""
    for factor, unit in ((1 << 30, "GiB"), (1 << 20, "MiB"), (1 << 10, "KiB")):
        if size >= factor:
            return f"{size / factor:.1f} {unit}"
    return f"{size:.0f} bytes"


def percent_text(fraction: float | None) -> str:
    """A fraction in percent; ``-`` where there is none."""
    return "-" if fraction is None else f"{100 * fraction:.2f} %"


def summary_lines(summary: Mapping[str, Any]) -> list[str]:
    return [str(summary), size_text(0), duration_text(0)]


def score_lines(classes: Mapping[str, Any], dtm: Mapping[str, Any] | None = None) -> list[str]:
    """Errors of the classes, and of the DTM where its truth is known.

    Parameters
    ----------
    classes : mapping
        As `tiler.evaluate.scores` gives them.
    dtm : mapping, optional
        As `tiler.evaluate.evaluate_dtm` gives them, in metres.
    """
    kappa = percent_text(classes["kappa"])
    lines = [
        f"type I  {percent_text(classes['type_1'])}  (ground lost)",
        f"type II {percent_text(classes['type_2'])}  (objects taken for ground)",
        f"total   {percent_text(classes['total'])}  of {classes['points']:,} points, kappa {kappa}",
    ]
    if classes["ignored"]:
        lines.append(f"ignored {classes['ignored']:,} points of the classes left out")
    unmatched = classes.get("unmatched_reference", 0), classes.get("unmatched_cloud", 0)
    if any(unmatched):
        lines.append(f"without a partner: {unmatched[0]:,} points of the reference, {unmatched[1]:,} of the cloud")
    if dtm is not None and dtm["rmse"] is not None:
        lines.append(f"DTM     RMSE {dtm['rmse']:.3f} m, bias {dtm['bias']:+.3f} m over {dtm['pixels']:,} pixels")
    return lines
