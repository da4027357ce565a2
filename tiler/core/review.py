"""Places to review: rows of `review.gpkg`, from the run and from the user who decided on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

LAYER = "review"
"""Layer of the places in their file."""
OPEN, OK, FIXED = "open", "ok", "fixed"
"""Values of the column ``status``: not looked at, right as it is, and to be changed by the edit of the row."""
STATUSES = (OPEN, OK, FIXED)
SAME_SHARE = 0.5
"""Least share of the area of a place inside an earlier place of the same reason that was found to be right."""


@dataclass(frozen=True, kw_only=True)
class ReviewRow:
    """Place to review.

    Attributes
    ----------
    shape : str
        Polygons in units of the CRS, as WKB in hexadecimal digits.
    status : str
        One of `STATUSES`. It is empty for an edit that the user drew into the layer.
    reason, why, remedy : str
        Kind of the problem, its cause and size, and what to do.
    action : str
        Action of an edit, see `tiler.core.edits`, or an empty text.
    z : float or None
        Height for the action `flat`, in vertical units of the CRS.
    stake_m : float or None
        Height by which the terrain may be wrong, in metres.
    area_m2 : float or None
    sheet : str
        Name of the sheet in which the middle of the place lies.
    without_returns : bool
        Whether the place is only the pixels in ``shape`` that lie in a gap without returns.
    """

    shape: str
    status: str = OPEN
    reason: str = ""
    why: str = ""
    remedy: str = ""
    action: str = ""
    z: float | None = None
    stake_m: float | None = None
    area_m2: float | None = None
    sheet: str = ""
    without_returns: bool = False


def is_edit(status: Any) -> bool:
    """Return whether a row with this status is an edit: it is fixed, or the user drew it and gave no status."""
    return status is None or str(status).strip().lower() in ("", FIXED)


def ranked(found: Sequence[ReviewRow], decided: Sequence[ReviewRow]) -> list[ReviewRow]:
    """Return the places of a run, the most serious first, and then the rows on which the user decided.

    A place that was found to be right is not listed again. A row that is fixed stays, because it is an edit. If its
    place is still found, the edit did not help, so the place is open.
    """
    import shapely

    right = [row for row in decided if row.status == OK]
    shapes = shapely.from_wkb([row.shape for row in right])
    tree = shapely.STRtree(shapes)
    rows = []
    for row in found:
        shape = shapely.from_wkb(row.shape)
        near = [i for i in tree.query(shape, "intersects") if right[i].reason == row.reason]
        inside = shapely.intersection(shape, shapely.union_all(shapes[near])).area
        if inside < SAME_SHARE * shape.area or not near:
            rows.append(row)
    return [*rows, *decided]


def without_open(rows: Sequence[ReviewRow]) -> list[ReviewRow]:
    """Return the rows on which the user decided, each once. Other texts in the status stay as they are."""
    decided = (replace(row, status=row.status.strip().lower()) for row in rows)
    return list(dict.fromkeys(row for row in decided if row.status != OPEN))
