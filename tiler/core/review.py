"""Places to review: rows of `review.gpkg`, from the run and from the user who decided on them."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tiler.core.chances import expected_loss

LAYER = "review"
"""Layer of the places in their file."""
OWN_COLUMNS = ("rank", "reason", "stake_m")
"""Columns by which places are known if their layer was renamed."""
TEXTS = ("status", "reason", "why", "action", "sheet", "remedy", "note")
NUMBERS = ("z", "stake_m", "area_m2", "chance")
"""Columns of a place in its file, besides ``rank``."""
OPEN, OK, FIXED = "open", "ok", "fixed"
"""Values of the column ``status``: not looked at, right as it is, and to be changed by the edit of the row."""
STATUSES = (OPEN, OK, FIXED)
FAILED, LEFT_OUT = "failed task", "file left out"
"""Reasons of places that cannot be right, since their task failed or their points are missing."""
BARE, HOLES = "bare", "holes"
"""Pixels with a height in a gap without returns, and pixels of the survey without a height."""
SAME_SHARE = 0.5
"""Least share of the area of a place inside an earlier place of the same reason that was found to be right."""
LEAST_SIDE_M = 5.0
"""Side of the square that is drawn around a place without an extent."""

COPY_SHARE = 0.99
"""Least share of the larger of two outlines in which a row and its copy overlap."""


@dataclass(frozen=True, kw_only=True)
class ReviewRow:
    """Place to review.

    Attributes
    ----------
    shape : str
        Polygons in units of the CRS, as WKB in hexadecimal digits.
    status : str
        One of `STATUSES`. In the file it may be empty, see `is_edit`.
    reason, why, remedy : str
        Kind of the problem, its cause and size, and what to do.
    action : str
        Action of an edit, see `tiler.core.edits`, or an empty text.
    z : float or None
        Height for the action `flat`, in vertical units of the CRS.
    stake_m : float or None
        Height by which the terrain may be wrong, in metres.
    area_m2 : float or None
    chance : float or None
        Chance that the terrain is wrong there, see `tiler.core.chances`. None if it is not known.
    sheet : str
        Name of the sheet in which the middle of the place lies.
    note : str
        Text of the user.
    pixels : str
        Pixels in ``shape`` that form the place: `BARE` or `HOLES`. Empty if the shape is the place.
    where : tuple of 4 float
        West, south, east and north of the problem of the run; empty for a row of the user.
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
    chance: float | None = None
    sheet: str = ""
    note: str = ""
    pixels: str = ""
    where: tuple[float, ...] = ()


def is_place(layer: str, columns: Container[str]) -> bool:
    """Return whether a feature is a place to review, also if its layer has another name or lacks a column."""
    return layer == LAYER or all(name in columns for name in OWN_COLUMNS)


def is_edit(status: Any) -> bool:
    """Return whether a row with this status is an edit: it is fixed, or the user drew it and gave no status."""
    return status is None or str(status).strip().lower() in ("", FIXED)


def ranked(
    found: Sequence[ReviewRow], decided: Sequence[ReviewRow]
) -> tuple[list[ReviewRow], list[ReviewRow]]:
    """Return the places of a run, worst first, and then the rows on which the user decided.

    Worst are those with the largest expected squared error (`expected_loss`), since a look at any place takes the same
    time. Places for which it is not known follow in their order in ``found``, and so do equal ones.

    A place that was found to be right is not listed again, but is in the second list. A row that is fixed stays,
    because it is an edit. If its place is still found, the edit did not help, so the place is open. The note of an
    earlier open row in ``decided`` stays with its place.
    """
    import shapely

    listed: list[ReviewRow] = []
    right: list[ReviewRow] = []
    noted = [(row, shapely.from_wkb(row.shape)) for row in decided if row.status == OPEN]
    covered = {row.reason: _Covered(decided, row.reason) for row in found}
    for row in found:
        shape = shapely.from_wkb(row.shape)
        if not shape.is_empty:
            if covered[row.reason].share(shape) >= SAME_SHARE:
                right.append(row)
            else:
                listed.append(replace(row, note=_note(row.reason, shape, noted)))
    own = (row for row in decided if row.status != OPEN)
    return [*sorted(listed, key=_by_loss), *own], right


def _note(reason: str, shape: Any, noted: Sequence[tuple[ReviewRow, Any]]) -> str:
    import shapely

    for row, outline in noted:
        if row.reason == reason and shapely.intersects(outline, shape):
            both = shapely.intersection(outline, shape)
            if both.area >= SAME_SHARE * shape.area:
                return row.note
    return ""


def _by_loss(row: ReviewRow) -> tuple[bool, float]:
    area_m2 = LEAST_SIDE_M**2 if row.area_m2 is None else row.area_m2
    loss = expected_loss(row.reason, row.chance, row.stake_m, area_m2)
    return loss is None, -(loss or 0.0)


class _Covered:
    """Area of the places of one reason that were found to be right."""

    def __init__(self, decided: Sequence[ReviewRow], reason: str) -> None:
        import shapely

        shapes = [row.shape for row in decided if row.status == OK and row.reason == reason]
        # The parts of a union do not overlap, so that areas can be added.
        self._parts = shapely.get_parts(shapely.union_all(shapely.from_wkb(shapes)))
        self._tree = shapely.STRtree(self._parts)

    def share(self, shape: Any) -> float:
        """Return the share of a shape that lies in them."""
        import shapely

        near = self._parts[self._tree.query(shape, "intersects")]
        return float(shapely.area(shapely.intersection(near, shape)).sum() / shape.area)


def decided_or_noted(rows: Sequence[ReviewRow]) -> list[ReviewRow]:
    """Return the rows on which the user decided, or that have a note, each once, with their status in lower case."""
    decided = (replace(row, status=_status(row)) for row in rows)
    return list(dict.fromkeys(row for row in decided if row.status != OPEN or row.note))


def _status(row: ReviewRow) -> str:
    status = row.status.strip().lower() or FIXED
    return OPEN if status == OK and row.reason in (FAILED, LEFT_OUT) else status


def without_copies(rows: Sequence[ReviewRow], of: Sequence[ReviewRow]) -> list[ReviewRow]:
    """Return the rows that are not in another file, in which rounding may have moved their outlines."""
    import shapely

    shapes = shapely.from_wkb([row.shape for row in of])
    return [row for row in rows if not _is_among(row, of, shapes)]


def _is_among(row: ReviewRow, rows: Sequence[ReviewRow], shapes: Any) -> bool:
    import shapely

    facts = (row.status, row.reason, row.action, row.z)
    same = [(r.status, r.reason, r.action, r.z) == facts for r in rows]
    shape, alike = shapely.from_wkb(row.shape), shapes[np.array(same, np.bool_)]
    both = shapely.area(shapely.intersection(alike, shape))
    whole = np.maximum(shapely.area(alike), shape.area)
    return bool((both >= COPY_SHARE * whole).any())
