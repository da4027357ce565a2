from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiler.core.lattice import Cell, CoordFrame, Lattice
from tiler.core.points import WITHHELD_FLAG, PointBlock, pack_origin
from tiler.core.records import to_json
from tiler.ingest.assemble import BucketParts, assemble_buckets, bucket_order

CELL = Cell(2, -1)
BUCKET, FINE = Lattice(Fraction(90)), Lattice(Fraction(10))
FRAME = CoordFrame(origin=(150, -100))


def block_of(xyz: Any, source: Any = 0, classes: Any = 1, flags: Any = 0) -> PointBlock:
    xyz = np.asarray(xyz, dtype=np.int32).reshape(-1, 3).T
    n = xyz.shape[1]
    sources = np.broadcast_to(np.asarray(source, dtype=np.int64), n)
    return PointBlock(
        np.ascontiguousarray(xyz),
        np.full(n, classes, np.uint8)
        if np.isscalar(classes)
        else np.asarray(classes, np.uint8),
        np.full(n, flags, np.uint8) if np.isscalar(flags) else np.asarray(flags, np.uint8),
        np.ones((2, n), np.uint8),
        None,
        (sources << 40) | np.arange(n, dtype=np.int64),
    )


def slow_candidates(
    block: PointBlock, taking: np.ndarray, fine: Lattice
) -> set[tuple[int, int, int]]:
    """The lowest point of each fine cell, found point by point."""
    best: dict[tuple[int, int], tuple[int, int, int]] = {}
    for (x, y, z), takes in zip(block.xyz.T.tolist(), taking.tolist(), strict=True):
        if takes:
            cell = (fine.index_of(x + FRAME.origin[0]), fine.index_of(y + FRAME.origin[1]))
            best[cell] = min(best.get(cell, (z, x, y)), (z, x, y))
    return {(x, y, z) for z, x, y in best.values()}


POINTS = st.lists(
    st.tuples(
        st.integers(30, 119),
        st.integers(10, 99),
        st.integers(-3, 3),
        st.integers(0, 2),
        st.booleans(),
    ),
    min_size=1,
    max_size=60,
)


@given(
    points=POINTS,
    fine=st.sampled_from([Fraction(10), Fraction(45), Fraction(90, 7), Fraction(1)]),
    seed=st.integers(0, 100),
)
def test_candidates_are_the_lowest_points_in_any_order_of_input(
    points: Any, fine: Fraction, seed: int
) -> None:
    block = block_of([p[:3] for p in points], source=[p[3] for p in points])
    taking = np.array([p[4] for p in points])
    lattice = Lattice(fine)
    found = bucket_order(block, taking, FRAME, lattice)
    assert sorted(found.order.tolist()) == list(range(len(points)))
    chosen = block.take(found.order[: found.n_candidates])
    assert found.n_candidates == len({tuple(p) for p in chosen.xyz.T.tolist()})
    assert {tuple(p) for p in chosen.xyz.T.tolist()} == slow_candidates(block, taking, lattice)
    places: dict[Any, list[int]] = {}
    for p in points:
        places.setdefault(p[:3], []).append(p[3])
    assert found.duplicates_within == sum(len(s) - len(set(s)) for s in places.values())
    assert found.duplicates_between == sum(len(set(s)) - 1 for s in places.values())
    shuffled = np.random.default_rng(seed).permutation(len(points))
    again = bucket_order(block.take(shuffled), taking[shuffled], FRAME, lattice)
    np.testing.assert_array_equal(
        block.take(shuffled).take(again.order).origin, block.take(found.order).origin
    )


def test_the_origin_of_the_frame_does_not_change_the_order() -> None:
    rng = np.random.default_rng(2)
    xyz = np.stack(
        [rng.integers(30, 120, 300), rng.integers(10, 100, 300), rng.integers(0, 9, 300)],
        axis=1,
    )
    taking = np.ones(300, dtype=bool)
    found = bucket_order(block_of(xyz), taking, FRAME, FINE)
    moved = bucket_order(
        block_of(xyz + [1000, -500, 0]),
        taking,
        CoordFrame(origin=(-850, 400)),
        FINE,
    )
    np.testing.assert_array_equal(found.order, moved.order)


def test_keys_too_long_for_one_word_give_the_same_order() -> None:
    rng = np.random.default_rng(3)
    xyz = rng.integers(0, 2**22, (3, 500)).astype(np.int32)
    xyz[2] = rng.choice([0, 2**31 - 1, -(2**31) + 1], 500)
    block = PointBlock(xyz, origin=pack_origin(0, np.arange(500, dtype=np.int64)))
    found = bucket_order(block, np.ones(500, bool), CoordFrame(), Lattice(Fraction(1)))
    np.testing.assert_array_equal(found.order, np.lexsort((xyz[0], xyz[1])))


def test_a_bucket_is_gathered_written_and_described(memory_store: Any) -> None:
    memory_store.meta.frame, memory_store.meta.bucket, memory_store.meta.fine = (
        FRAME,
        BUCKET,
        FINE,
    )
    memory_store.pieces["a"] = block_of(
        [[99, 99, 9], [30, 10, 5], [31, 11, 4]], classes=[1, 2, 7]
    )
    memory_store.pieces["b"] = block_of(
        [[30, 10, 5], [32, 12, 3]], source=1, flags=[0, WITHHELD_FLAG]
    )
    buckets = (BucketParts(Cell(2, -1), (("a", 1, 3), ("b", 0, 2))),)
    record = assemble_buckets(memory_store, buckets=buckets, keep_classes=(7, 18))
    assert to_json(record) == {
        "buckets": [
            {
                "cell": [2, -1],
                "n": 4,
                "n_candidates": 1,
                "n_participating": 2,
                "n_measured": 1,
                "duplicates": {"within": 0, "between": 1},
                "z_participating": [5, 5],
                "classes": {"1": 2, "2": 1, "7": 1},
                "bounds": [180, -90, 183, -87],
                "z": [3, 5],
                "strays": [],
            }
        ]
    }
    written = memory_store.written[CELL]
    assert memory_store.candidates[CELL] == 1
    assert written.xyz[:, 0].tolist() == [30, 10, 5]
    assert written.origin[0] == 1
    assert len(written) == 4


def test_a_bucket_in_which_no_point_takes_part(memory_store: Any) -> None:
    memory_store.meta.frame, memory_store.meta.bucket, memory_store.meta.fine = (
        FRAME,
        BUCKET,
        FINE,
    )
    memory_store.pieces["a"] = block_of([[30, 10, 5]], classes=18)
    buckets = (BucketParts(Cell(2, -1), (("a", 0, 1),)),)
    (bucket,) = assemble_buckets(memory_store, buckets=buckets).buckets
    assert (bucket.n, bucket.n_candidates, bucket.z_participating) == (1, 0, None)


def test_fragments_without_classes_are_refused(memory_store: Any) -> None:
    memory_store.pieces["a"] = PointBlock(np.zeros((3, 1), np.int32))
    with pytest.raises(ValueError, match="classes and flags"):
        assemble_buckets(memory_store, buckets=(BucketParts(Cell(0, 0), (("a", 0, 1),)),))
