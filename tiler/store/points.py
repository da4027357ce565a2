"""Points in chunk-owned columns: a bucket owns whole rows, so each chunk has exactly one writer."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.core.lattice import Bounds
from tiler.core.points import PointBlock
from tiler.errors import ConfigError, StoreError
from tiler.store import arrays, layout
from tiler.store.index import Bucket
from tiler.store.layout import ROW_POINTS, Column
from tiler.store.storage import Storage

Keep = Callable[[PointBlock, list["Part"]], npt.NDArray[np.bool_] | None]

_ROWS_AT_ONCE = 8
"""Rows of one request to zarr: their chunks are fetched together, their padding is all that is read too much."""


@dataclass(frozen=True)
class Part:
    """The first ``n`` points of a row of a bucket."""

    bucket: Bucket
    row: int
    n: int


def parts_of(bucket: Bucket, n: int) -> list[Part]:
    """The rows that hold the first ``n`` points of a bucket."""
    starts = range(0, n, ROW_POINTS)
    return [Part(bucket, bucket.row + i, min(ROW_POINTS, n - start)) for i, start in enumerate(starts)]


class PointColumns:
    """The columns of one store.

    Parameters
    ----------
    storage : Storage
    has_rgb : bool
        Whether the points have colours.
    """

    def __init__(self, storage: Storage, has_rgb: bool) -> None:
        self._storage = storage
        self._columns = layout.columns(has_rgb)

    @cached_property
    def _arrays(self) -> dict[str, arrays.ZarrArray]:
        return {c.name: self._open(c) for c in self._columns}

    def _open(self, column: Column) -> arrays.ZarrArray:
        return arrays.open_array(self._storage, layout.points_path(column.name), column.kind)

    def grow(self, rows: int) -> None:
        """Make the columns, or lengthen them, to ``rows`` rows: for the coordinator alone."""
        for column in self._columns:
            lengthen(
                self._storage, layout.points_path(column.name), column.kind, (rows, column.width, ROW_POINTS)
            )
        self.__dict__.pop("_arrays", None)

    def delete_rows(self, bucket: Bucket) -> None:
        """Remove the chunks of a bucket that moved away."""
        for column in self._columns:
            delete_rows(self._storage, layout.points_path(column.name), bucket)

    def write(self, bucket: Bucket, block: PointBlock) -> None:
        """Write all points of a bucket, whole chunks only; StoreError where a column is missing."""
        for column in self._columns:
            values = self._joined(column, block, bucket)
            write_rows(self._storage, self._arrays[column.name], bucket, values)

    def _joined(self, column: Column, block: PointBlock, bucket: Bucket) -> npt.NDArray[Any]:
        values = np.empty((column.width, len(block)), dtype=column.kind.dtype)
        for field, part in column.fields.items():
            source = getattr(block, field)
            if source is None or source.dtype != values.dtype or source.shape[-1] != len(block):
                raise StoreError(
                    f"bucket {bucket.cell.name}: needs a column {field} of {len(block)} {values.dtype}"
                )
            values[part] = source
        return values

    def read(
        self,
        parts: Sequence[Part],
        fields: Sequence[str],
        keep: Keep | None = None,
        labels: arrays.ZarrArray | None = None,
    ) -> PointBlock:
        """The points of ``parts`` in order, those of each batch masked by ``keep``.

        Parameters
        ----------
        parts : sequence of Part
        fields : sequence of str
            Fields of `PointBlock`; xyz always comes along, rgb stays None where the store has none.
        keep : callable, optional
            Given a batch's xyz and its parts: the mask of the points to keep, None for all.
        labels : zarr array, optional
            Labels of a pass, to come along.
        """
        columns = self._needed(fields)
        labelled: list[npt.NDArray[np.uint8]] = []
        gathered: dict[str, list[npt.NDArray[Any]]] = {c.name: [] for c in columns}
        for start in range(0, len(parts), _ROWS_AT_ONCE):
            batch = list(parts[start : start + _ROWS_AT_ONCE])
            mask: npt.NDArray[np.bool_] | None = None
            for column in columns:
                values = read_rows(self._storage, self._arrays[column.name], batch)
                if column.name == "xyz" and keep is not None:
                    mask = keep(PointBlock(values), batch)
                    if mask is not None and not mask.any():
                        break
                gathered[column.name].append(values if mask is None else values[:, mask])
            if labels is not None and (mask is None or mask.any()):
                found = read_rows(self._storage, labels, batch)[0]
                labelled.append(found if mask is None else found[mask])
        block = self._block(columns, gathered, fields)
        if labels is None:
            return block
        return replace(block, labels=np.concatenate([np.zeros(0, np.uint8), *labelled]))

    def _needed(self, fields: Sequence[str]) -> list[Column]:
        known = {field for c in layout.COLUMNS for field in c.fields}
        for field in fields:
            if field not in known:
                raise ConfigError(f"no column {field!r}: the store has {', '.join(sorted(known))}")
        return [c for c in self._columns if c.name == "xyz" or any(f in c.fields for f in fields)]

    def _block(
        self, columns: list[Column], gathered: dict[str, list[npt.NDArray[Any]]], fields: Sequence[str]
    ) -> PointBlock:
        found: dict[str, npt.NDArray[Any]] = {}
        for column in columns:
            pieces = gathered.pop(column.name)  # freed column by column: the peak is one column twice
            empty = np.empty((column.width, 0), dtype=column.kind.dtype)
            values = np.concatenate(pieces, axis=1) if len(pieces) > 1 else pieces[0] if pieces else empty
            for field, part in column.fields.items():
                if field in fields or field == "xyz":
                    found[field] = values[part.start] if part.stop - part.start == 1 else values[part]
        return PointBlock(**found)


def inside(bounds: Bounds, origin: tuple[int, int], cell_bounds: Callable[[Bucket], Bounds]) -> Keep:
    """A `Keep` for the points of ``bounds``; buckets that lie inside as a whole are not looked at."""

    def keep(block: PointBlock, parts: list[Part]) -> npt.NDArray[np.bool_] | None:
        areas = (cell_bounds(p.bucket) for p in parts)
        if all(
            a.x0 >= bounds.x0 and a.y0 >= bounds.y0 and a.x1 <= bounds.x1 and a.y1 <= bounds.y1 for a in areas
        ):
            return None
        return block.inside(bounds, origin)

    return keep


def lengthen(storage: Storage, path: str, kind: layout.ArrayKind, shape: tuple[int, ...]) -> None:
    """Make the array at ``path``, or lengthen it along its first axis; never shortens."""
    array = arrays.find_array(storage, path, kind) or arrays.create_array(storage, path, shape, kind)
    if array.shape[0] < shape[0]:
        arrays.lengthen_array(storage, path, kind, shape)


def delete_rows(storage: Storage, path: str, bucket: Bucket) -> None:
    """Remove the chunks of a bucket's rows."""
    for row in range(bucket.row, bucket.row + bucket.rows):
        storage.delete(f"{path}/c/{row}/0/0")


def write_rows(storage: Storage, array: arrays.ZarrArray, bucket: Bucket, values: npt.NDArray[Any]) -> None:
    """Write ``values`` (width, n) to the rows of a bucket; the last row is padded, so that zarr never reads first."""
    for part in parts_of(bucket, values.shape[1]):
        start = (part.row - bucket.row) * ROW_POINTS
        row = np.zeros((1, values.shape[0], ROW_POINTS), dtype=values.dtype)
        row[0, :, : part.n] = values[:, start : start + part.n]
        arrays.write(storage, array, (slice(part.row, part.row + 1), slice(None), slice(None)), row)


def read_rows(storage: Storage, array: arrays.ZarrArray, parts: Sequence[Part]) -> npt.NDArray[Any]:
    """The values (width, n) of ``parts``, side by side."""
    pieces = []
    for run in _runs(parts):
        longest = max(part.n for part in run)
        selection = (slice(run[0].row, run[-1].row + 1), slice(None), slice(0, longest))
        rows = arrays.read(storage, array, selection)
        pieces += [row[:, : part.n] for row, part in zip(rows, run, strict=True)]
    return np.ascontiguousarray(pieces[0]) if len(pieces) == 1 else np.concatenate(pieces, axis=1)


def _runs(parts: Sequence[Part]) -> Iterator[list[Part]]:
    """Parts whose rows follow one another."""
    run: list[Part] = []
    for part in parts:
        if run and part.row != run[-1].row + 1:
            yield run
            run = []
        run.append(part)
    if run:
        yield run
