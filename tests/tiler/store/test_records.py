"""Kept records of sources: any range comes back, but no record of another source or of a part."""

from __future__ import annotations

import numpy as np
import pytest

from tiler.store import SPOOL_CHUNK, KeptPiece, TileStore

TYPE = np.dtype([("a", "<i4"), ("b", "u1", 3)])
WIDER = np.dtype([*TYPE.descr, ("c", "u1")])


def test_any_range_comes_back(local_store: TileStore) -> None:
    lengths = (SPOOL_CHUNK + 10, 5, 2 * SPOOL_CHUNK)
    total = sum(lengths)
    records = np.zeros(total, TYPE)
    records["a"], records["b"] = np.arange(total), np.arange(3 * total).reshape(total, 3) % 251
    pieces, start = [], 0
    for number, length in enumerate(lengths):
        keeper = local_store.keep_records(f"p{number}", "same", TYPE.itemsize)
        for at in range(start, start + length, SPOOL_CHUNK):
            keeper.add(records[at : min(at + SPOOL_CHUNK, start + length)])
        assert (
            local_store.records([KeptPiece(f"p{number}", 0, length, "same")], length, TYPE)
            is None
        )
        keeper.close()
        pieces.append(KeptPiece(f"p{number}", start, length, "same"))
        start += length
    kept = local_store.records(pieces, total, TYPE)
    assert kept is not None
    for first, count in [
        (0, total),
        (0, 1),
        (SPOOL_CHUNK - 1, 12),
        (SPOOL_CHUNK + 9, 7),
        (total - 1, 1),
    ]:
        assert np.array_equal(kept.read(first, count), records[first : first + count])


@pytest.mark.parametrize(
    ("pieces", "count", "dtype"),
    [
        ([], 4, TYPE),
        ([KeptPiece("gone", 0, 4, "same")], 4, TYPE),
        ([KeptPiece("p", 0, 4, "another")], 4, TYPE),
        ([KeptPiece("p", 0, 5, "same")], 5, TYPE),
        ([KeptPiece("p", 1, 4, "same")], 5, TYPE),
        ([KeptPiece("p", 0, 4, "same")], 5, TYPE),
        ([KeptPiece("p", 0, 4, "later")], 4, WIDER),  # the same name, a file of another format
    ],
)
def test_records_of_a_part_of_a_source_are_not_used(
    local_store: TileStore, pieces: list[KeptPiece], count: int, dtype: np.dtype[np.void]
) -> None:
    keeper = local_store.keep_records("p", "same", TYPE.itemsize)
    keeper.add(np.zeros(4, TYPE))
    keeper.close()
    assert local_store.records(pieces, count, dtype) is None
