"""Points come back as they went in, and a window holds exactly the points inside it, each once."""

from __future__ import annotations

import uuid
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.tiler.store.conftest import make_points, put_points
from tiler.core.lattice import Bounds, Cell
from tiler.core.points import PointBlock
from tiler.errors import ConfigError, StoreError
from tiler.store import BucketInfo, StoreMeta, TileStore, create_store, open_store
from tiler.store.layout import ROW_POINTS

FIELDS = tuple(f.name for f in fields(PointBlock) if f.name != "labels")

coordinates = st.integers(-9_000, 9_000)
# Coordinates near the lines between buckets (at multiples of 10000/3) are where a point could
# be lost.
near_lines = st.builds(
    lambda i, d: -(-i * 10_000 // 3) + d, st.integers(-2, 2), st.integers(-1, 1)
)


def same(a: PointBlock, b: PointBlock, names: tuple[str, ...] = FIELDS) -> bool:
    return all(
        getattr(a, n).dtype == getattr(b, n).dtype
        and np.array_equal(getattr(a, n), getattr(b, n))
        for n in names
    )


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    where=st.lists(st.tuples(coordinates | near_lines, coordinates | near_lines), max_size=60),
    corners=st.tuples(*[coordinates | near_lines] * 4),
    candidates_only=st.booleans(),
)
def test_a_window_holds_the_points_inside_each_once(
    where: list[tuple[int, int]],
    corners: tuple[int, int, int, int],
    candidates_only: bool,
    meta: StoreMeta,
) -> None:
    x, y = np.array(where, dtype=np.int64).reshape(-1, 2).T
    block = make_points(x, y)
    store = create_store(f"memory://{uuid.uuid4().hex}", meta)
    infos = put_points(store, block)
    bounds = Bounds(*corners)

    places: dict[Cell, slice] = {}
    found = open_store(store.url).window(bounds, FIELDS, candidates_only, places=places)

    for cell, place in places.items():
        own = store.read_bucket(cell, FIELDS, candidates_only)
        assert same(found.take(place), own.take(own.inside(bounds, meta.frame.origin)))
    assert sum(place.stop - place.start for place in places.values()) == len(found)
    expected = [
        store.read_bucket(cell, FIELDS, candidates_only)
        for cell in sorted(infos, key=lambda c: (c.iy, c.ix))
    ]
    whole = PointBlock.concatenate([block.take(slice(0, 0)), *expected])
    assert same(found, whole.take(whole.inside(bounds, meta.frame.origin)))
    if not candidates_only:
        inside = block.take(block.inside(bounds, meta.frame.origin))
        assert sorted(found.origin.tolist()) == sorted(inside.origin.tolist())  # type: ignore[union-attr]


def test_every_column_and_dtype_comes_back(store: TileStore) -> None:
    block = make_points(np.arange(1000), np.arange(1000, 2000))
    store.allocate({Cell(0, 0): 1000})
    store.publish_index({Cell(0, 0): store.write_bucket(Cell(0, 0), block, 300)})

    read = open_store(store.url)
    assert read.buckets() == {Cell(0, 0): BucketInfo(1000, 300)}
    assert same(read.read_bucket(Cell(0, 0), FIELDS), block)
    assert same(
        read.read_bucket(Cell(0, 0), FIELDS, candidates_only=True), block.take(slice(0, 300))
    )


def test_only_the_requested_columns_are_read(filled: TileStore) -> None:
    cell = next(iter(filled.buckets()))
    block = filled.read_bucket(cell, ("flags", "origin"))
    assert [n for n in FIELDS if getattr(block, n) is not None] == ["xyz", "flags", "origin"]


def test_a_bucket_of_several_rows_comes_back(local_store: TileStore) -> None:
    n = 2 * ROW_POINTS + 5
    rng = np.random.default_rng(1)
    block = make_points(*rng.integers(0, 3333, (2, n)))
    local_store.allocate({Cell(0, 0): n, Cell(1, 0): 1})
    infos = {Cell(0, 0): local_store.write_bucket(Cell(0, 0), block, ROW_POINTS + 1)}
    infos[Cell(1, 0)] = local_store.write_bucket(
        Cell(1, 0), make_points(np.array([3334]), np.array([0])), 0
    )
    local_store.publish_index(infos)

    assert same(local_store.read_bucket(Cell(0, 0), FIELDS), block)
    candidates = local_store.read_bucket(Cell(0, 0), FIELDS, candidates_only=True)
    assert same(candidates, block.take(slice(0, ROW_POINTS + 1)))
    bounds = Bounds(100, 0, 4000, 50)
    inside = block.take(block.inside(bounds, local_store.meta.frame.origin))
    window = local_store.window(bounds, FIELDS)
    assert len(window) == len(inside) + 1
    assert same(window.take(slice(0, len(inside))), inside)


def test_an_empty_bucket_and_an_empty_store(local_store: TileStore) -> None:
    everywhere = Bounds(-(10**6), -(10**6), 10**6, 10**6)
    local_store.allocate({})
    assert local_store.buckets() == {}
    assert len(local_store.window(everywhere, FIELDS)) == 0

    nothing = make_points(np.empty(0, np.int64), np.empty(0, np.int64))
    local_store.allocate({Cell(3, 3): 0})
    local_store.publish_index({Cell(3, 3): local_store.write_bucket(Cell(3, 3), nothing, 0)})
    assert same(local_store.read_bucket(Cell(3, 3), FIELDS), nothing)
    assert same(local_store.window(everywhere, FIELDS), nothing)


def test_a_store_without_colours_has_none(tmp_path: str, meta: StoreMeta) -> None:
    store = create_store(
        f"{tmp_path}/s", StoreMeta(meta.frame, meta.bucket, meta.fine, has_rgb=False)
    )
    put_points(store, make_points(np.arange(9), np.arange(9), has_rgb=False))
    block = store.read_bucket(Cell(0, 0), FIELDS)
    assert block.rgb is None
    assert len(block) == 9


def test_an_unknown_column_is_refused(filled: TileStore) -> None:
    with pytest.raises(ConfigError, match="no column 'gps_time': the store has classification"):
        filled.read_bucket(next(iter(filled.buckets())), ("gps_time",))


@pytest.mark.parametrize(
    ("x", "candidates", "drop", "message"),
    [
        ([5, 6, 7], 0, None, "do not fit 0 rows; allocate first"),
        ([5], 2, None, "2 of them candidates"),
        ([-1], 0, None, "lies outside"),
        ([3334], 0, None, "lies outside"),
        ([5], 0, "flags", "needs a column flags of 1 uint8"),
    ],
)
def test_a_bucket_with_wrong_points_is_refused(
    local_store: TileStore, x: list[int], candidates: int, drop: str | None, message: str
) -> None:
    local_store.allocate({Cell(0, 0): 0 if len(x) > 1 else 1})
    block = make_points(np.array(x), np.zeros(len(x), np.int64))
    if drop:
        block = PointBlock(**{n: None if n == drop else getattr(block, n) for n in FIELDS})
    with pytest.raises(StoreError, match=message):
        local_store.write_bucket(Cell(0, 0), block, candidates)


def test_a_bucket_that_was_not_allocated_or_published_is_refused(
    local_store: TileStore,
) -> None:
    block = make_points(np.array([5]), np.array([5]))
    with pytest.raises(StoreError, match=r"bucket \+00\+00: not in .*; allocate first"):
        local_store.write_bucket(Cell(0, 0), block, 0)
    local_store.allocate({Cell(0, 0): 1})
    local_store.write_bucket(Cell(0, 0), block, 0)
    assert local_store.buckets() == {}
    with pytest.raises(StoreError, match="not published yet"):
        local_store.read_bucket(Cell(0, 0))


def test_labels_come_along(filled: TileStore) -> None:
    """Labels stay with their points in a window and among candidates."""
    rng = np.random.default_rng(5)
    given = {}
    for cell, info in filled.buckets().items():
        given[cell] = rng.integers(0, 256, info.n).astype(np.uint8)
        filled.write_labels("some", cell, given[cell])
    everywhere = Bounds(-(10**9), -(10**9), 10**9, 10**9)
    for candidates_only in (False, True):
        found = filled.window(everywhere, ("origin",), candidates_only, labels="some")
        expected = [
            given[cell][: info.n_candidates if candidates_only else info.n]
            for cell, info in sorted(
                filled.buckets().items(), key=lambda item: (item[0].iy, item[0].ix)
            )
        ]
        assert found.labels is not None
        assert np.array_equal(found.labels, np.concatenate(expected))
        assert len(found) == found.labels.size
    assert filled.window(Bounds(10**8, 0, 10**8 + 5, 5), labels="some").labels.size == 0  # type: ignore[union-attr]
