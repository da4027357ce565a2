"""Commits: written once, atomically, and removable."""

from __future__ import annotations

from pathlib import Path

import pytest

from tiler.errors import StoreError
from tiler.store import StoreMeta, TileStore, create_store, open_store


@pytest.fixture(params=[False, True], ids=["single", "packed"])
def store(request: pytest.FixtureRequest, store: TileStore) -> TileStore:
    store.commit("filter", "+1-2", "aa", {"n": 1, "nested": {"x": [1.5, None]}})
    store.commit("filter", "b.c", "bb", {})
    store.commit("grid", "+1-2", "cc", {"other": True})
    if request.param:
        store.compact("filter")
    return store


def test_commits_come_back_per_stage(store: TileStore) -> None:
    again = open_store(store.url)
    assert again.committed("filter") == {
        "+1-2": ("aa", {"n": 1, "nested": {"x": [1.5, None]}}),
        "b.c": ("bb", {}),
    }
    assert again.committed("grid") == {"+1-2": ("cc", {"other": True})}
    assert again.committed("export") == {}


def test_the_last_commit_counts(store: TileStore) -> None:
    store.commit("filter", "b.c", "dd", {"again": 1})
    assert store.committed("filter")["b.c"] == ("dd", {"again": 1})
    store.compact("filter")
    assert store.committed("filter")["b.c"] == ("dd", {"again": 1})


def test_a_commit_can_be_taken_back(store: TileStore) -> None:
    store.uncommit("filter", "b.c")
    assert list(store.committed("filter")) == ["+1-2"]
    assert len(store.committed("grid")) == 1


def test_a_stage_can_be_cleared(store: TileStore) -> None:
    store.clear("filter")
    store.clear("export")
    assert store.committed("filter") == {}
    assert len(store.committed("grid")) == 1


def test_each_owner_has_commits_of_its_own(store: TileStore) -> None:
    first, second = store.committed("filter"), {"b.c": ("of two", {"m": 2})}
    store.keep_apart(["filter"], "one")
    assert store.committed("filter") == first
    store.keep_apart(["filter"], "two")
    assert store.committed("filter") == {}
    store.commit("filter", "b.c", *second["b.c"])
    for _ in range(2):
        store.keep_apart(["filter"], "one")
        assert store.committed("filter") == first
        store.keep_apart(["filter"], "two")
        assert store.committed("filter") == second
    assert len(store.committed("grid")) == 1


def test_another_token_in_a_url_is_no_other_owner(store: TileStore) -> None:
    first = store.committed("filter")
    for token in ("a", "a", "b"):
        store.keep_apart(["filter"], f"https://user:{token}@host/out?X-Amz-Signature={token}")
        assert store.committed("filter") == first


def test_state_comes_back(store: TileStore) -> None:
    assert store.get_state("plan") is None
    store.put_state("plan", {"tiles": [1, 2], "ä": None})
    store.put_state("empty", [])
    assert open_store(store.url).get_state("plan") == {"tiles": [1, 2], "ä": None}
    assert store.get_state("empty") == []
    with pytest.raises(StoreError, match="state plan: not JSON-able"):
        store.put_state("plan", {1, 2})


@pytest.mark.parametrize("name", ["", "a/b", "..", ".hidden", "a b", "x" * 201, "\u00e4"])
def test_names_that_cannot_be_keys_are_refused(store: TileStore, name: str) -> None:
    with pytest.raises(StoreError, match="is not a valid name"):
        store.commit("filter", name, "", {})
    with pytest.raises(StoreError, match="is not a valid name"):
        store.put_state(name, {})


@pytest.mark.parametrize(
    "damage", [lambda b: b[: len(b) // 2], lambda b: b.replace(b"aa", b"ab"), lambda b: b""]
)
def test_a_damaged_commit_counts_as_missing(
    tmp_path: Path, meta: StoreMeta, damage: object
) -> None:
    store = create_store(str(tmp_path / "s"), meta)
    store.commit("filter", "k", "aa", {})
    path = tmp_path / "s" / "commits" / "filter" / "k.json"
    path.write_bytes(damage(path.read_bytes()))  # type: ignore[operator]
    assert store.committed("filter") == {}
    store.commit("filter", "k", "aa", {})
    store.compact("filter")
    path = tmp_path / "s" / "packs" / "filter.json"
    path.write_bytes(damage(path.read_bytes()))  # type: ignore[operator]
    assert store.committed("filter") == {}


def test_a_half_written_commit_counts_as_missing(
    local_store: TileStore, tmp_path: Path
) -> None:
    local_store.commit("filter", "k", "aa", {})
    (tmp_path / "store.zarr" / "commits" / "filter" / "l.0123.partial").write_bytes(b'{"crc32"')
    assert list(local_store.committed("filter")) == ["k"]
