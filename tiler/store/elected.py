"""Points that a pass elects, and their labels: a bucket's lie in the first places of its rows."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from tiler.core.lattice import Bounds
from tiler.core.points import PointBlock
from tiler.errors import StoreError
from tiler.store import points
from tiler.store.index import Bucket
from tiler.store.layout import NOWHERE, ROW_POINTS
from tiler.store.rows import RowArray

_ROWS_AT_ONCE = 8


def places(bucket: Bucket, n: int) -> list[points.Part]:
    """The rows that a bucket of ``n`` points has for elected ones: whole, as only they say how many there are."""
    return [points.Part(bucket, part.row, ROW_POINTS) for part in points.parts_of(bucket, n)]


def write(array: RowArray, bucket: Bucket, n: int, values: npt.NDArray[np.generic]) -> None:
    """Write elected points (3, m) of a bucket of ``n`` points, or labels (1, m); StoreError where they have no room."""
    room = len(places(bucket, n)) * ROW_POINTS
    m = values.shape[1]
    if m > room:
        raise StoreError(
            f"bucket {bucket.cell.name}: {m} elected points do not fit the rows of {n} points; "
            "elect no more than there are"
        )
    full = np.full((values.shape[0], room), array.kind.fill, values.dtype)
    full[:, :m] = values
    points.write_rows(array, bucket, full)


def read(
    array: RowArray,
    labels: RowArray | None,
    parts: Iterable[points.Part],
    bounds: Bounds,
    origin: tuple[int, int],
) -> PointBlock:
    """The elected points of ``bounds`` in those rows, with labels if asked for."""
    held: list[npt.NDArray[np.int32]] = [np.empty((3, 0), np.int32)]
    labelled: list[npt.NDArray[np.uint8]] = [np.empty(0, np.uint8)]
    wanted = list(parts)
    for start in range(0, len(wanted), _ROWS_AT_ONCE):
        batch = wanted[start : start + _ROWS_AT_ONCE]
        xyz = points.read_rows(array, batch)
        keep = (xyz[0] != NOWHERE) & PointBlock(xyz).inside(bounds, origin)
        held.append(xyz[:, keep])
        if labels is not None:
            labelled.append(points.read_rows(labels, batch)[0, keep])
    return PointBlock(
        np.concatenate(held, axis=1), labels=None if labels is None else np.concatenate(labelled)
    )
