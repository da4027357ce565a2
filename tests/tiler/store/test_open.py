"""Only stores that this version wrote are opened, and nothing else is overwritten."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from pyproj import CRS

from tests.tiler.store.conftest import make_points, pixels
from tiler.core.lattice import Cell, CoordFrame, Lattice
from tiler.core.points import PointBlock
from tiler.core.raster import Block
from tiler.core.units import US_SURVEY_FOOT, Units
from tiler.errors import ConfigError, ForeignStoreError, StoreError
from tiler.store import (
    StoreMeta,
    TileStore,
    create_store,
    held_store,
    layout,
    open_store,
    remove_store,
)
from tiler.store.storage import Storage, sealed

FEET = StoreMeta(
    CoordFrame(
        Units(US_SURVEY_FOOT, Fraction(3048, 10000)),
        (-(2**40), 5),
        CRS.from_epsg(2225).to_wkt().replace("NAD83", "ä", 1),
    ),
    Lattice(Fraction(10**9, 3937)),
    Lattice(Fraction(10**9, 3937 * 7)),
    False,
)


def edit(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change metadata, and their checksum with them."""
    data = json.loads(path.read_text())
    change(data)
    # The folder of the store is the one that ends in .zarr.
    (root,) = (p for p in path.parents if p.suffix == ".zarr")
    path.write_text(json.dumps(sealed(path.relative_to(root).as_posix(), data)))


def test_the_description_comes_back_exactly(store_url: str) -> None:
    assert create_store(store_url, FEET).meta == FEET
    assert open_store(store_url).meta == FEET


def test_buckets_are_whole_numbers_of_fine_cells(meta: StoreMeta) -> None:
    with pytest.raises(ConfigError, match="is not a multiple of the candidate cell"):
        StoreMeta(meta.frame, Lattice(Fraction(10)), Lattice(Fraction(3)), False)


def test_making_a_store_again_opens_it(store_url: str, meta: StoreMeta) -> None:
    create_store(store_url, meta).put_state("plan", 1)
    assert create_store(store_url, meta).get_state("plan") == 1
    with pytest.raises(ConfigError, match="other settings or inputs; use --overwrite"):
        create_store(store_url, replace(meta, has_rgb=False))


def test_looking_for_a_store_creates_nothing(tmp_path: Path) -> None:
    place = tmp_path / "none"
    with pytest.raises(StoreError, match="no tile store here"):
        open_store(str(place))
    remove_store(str(place))
    assert not place.exists()


def test_a_file_url_is_a_local_path(tmp_path: Path, meta: StoreMeta) -> None:
    create_store(f"file://{tmp_path}/s", meta)
    assert open_store(str(tmp_path / "s")).meta == meta


def test_an_unknown_scheme_is_refused() -> None:
    with pytest.raises(ConfigError, match="cannot be opened"):
        open_store("nosuchscheme://x/y")


def test_a_folder_with_other_content_is_neither_used_nor_deleted(
    tmp_path: Path, meta: StoreMeta
) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(StoreError, match="contains something other"):
        create_store(str(tmp_path), meta)
    with pytest.raises(StoreError, match="contains something other"):
        remove_store(str(tmp_path))
    assert (tmp_path / "thesis.tex").exists()


def test_a_foreign_zarr_group_is_refused(tmp_path: Path, meta: StoreMeta) -> None:
    zarr.create_group(str(tmp_path / "g"), attributes={"mine": 1}, zarr_format=3)
    for action in (open_store, lambda url: create_store(url, meta)):
        with pytest.raises(StoreError, match="not a tile store of tiler"):
            action(str(tmp_path / "g"))
    with pytest.raises(StoreError, match="remove it yourself"):
        remove_store(str(tmp_path / "g"))
    assert (tmp_path / "g" / "zarr.json").exists()


def test_a_store_of_another_schema_is_refused(local_store: TileStore) -> None:
    edit(
        Path(local_store.url, "zarr.json"),
        lambda d: d["attributes"]["tiler_store"].update(schema=99),
    )
    with pytest.raises(StoreError, match="store of schema 99, this version reads"):
        open_store(local_store.url)


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["attributes"]["tiler_store"].pop("frame"),
        lambda d: d["attributes"]["tiler_store"].update(bucket="1/0"),
        lambda d: d["attributes"]["tiler_store"].update(fine="7"),
    ],
)
def test_a_damaged_description_is_refused(
    local_store: TileStore, change: Callable[[dict[str, Any]], object]
) -> None:
    edit(Path(local_store.url, "zarr.json"), change)
    with pytest.raises(StoreError, match="description is damaged"):
        open_store(local_store.url)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["codecs"].append({"name": "pickle"}), "codec pickle is not allowed"),
        (
            lambda d: d["codecs"].insert(0, {"name": "transpose"}),
            "codec transpose is not allowed",
        ),
        (lambda d: d.update(data_type="float64"), "not an array that this version writes"),
        (
            lambda d: d["chunk_grid"]["configuration"].update(chunk_shape=[1, 3, 9]),
            "not an array that this",
        ),
        (
            lambda d: d.update(storage_transformers=[{"name": "x"}]),
            "not an array that this version writes",
        ),
        (lambda d: d.pop("codecs"), "metadata are damaged"),
        (lambda d: d.update(codecs="blosc"), "metadata are damaged"),
    ],
)
def test_an_array_that_tiler_does_not_write_is_refused(
    filled: TileStore, change: Callable[[dict[str, Any]], object], message: str
) -> None:
    edit(Path(filled.url, "points", "xyz", "zarr.json"), change)
    store = open_store(filled.url)
    with pytest.raises(StoreError, match=message):
        store.read_bucket(next(iter(store.buckets())))


def test_a_store_is_removed_whole(store_url: str, meta: StoreMeta) -> None:
    store = create_store(store_url, meta)
    store.allocate({Cell(0, 0): 5})
    store.put_state("plan", 1)
    assert store.usage().objects > 5
    remove_store(store_url)
    assert store.usage().objects == 0
    create_store(store_url, FEET).create_raster("dtm", pixels(3, 3))
    assert np.all(open_store(store_url).meta == FEET)


def test_a_file_in_place_of_a_store_is_refused(tmp_path: Path, meta: StoreMeta) -> None:
    (tmp_path / "store.zarr").write_text("notes")
    with pytest.raises(ForeignStoreError, match="is a file") as caught:
        create_store(str(tmp_path / "store.zarr"), meta)
    assert caught.value.exit_code == 2, (
        "another place has to be named: nothing was wrong with the work"
    )


def test_only_files_of_the_store_are_removed(filled: TileStore) -> None:
    root = Path(filled.url)
    mine = [
        "notes.txt",
        "points/notes.txt",
        "points/xyz/c.0/notes",
        "state/notes.md",
        "clouds/a.laz",
    ]
    mine += ["a.partial", "spool/s0/a.laz", "commits/filter0/notes.txt"]
    for name in mine:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text("mine")
    (root / "points" / "link").symlink_to(root / "clouds")
    scratch = root / "points" / "xyz" / f"c.0.0.0.{'0a' * 16}.partial"
    scratch.write_bytes(b"killed")
    filled.write_piece("s0", _no_points())
    filled.drop_spool()
    filled.clean_up()
    assert not scratch.exists()
    left = remove_store(filled.url)
    assert left == ["a.partial", "clouds", "commits", "notes.txt", "points", "spool", "state"]
    assert sorted(
        p.relative_to(root).as_posix() for p in root.rglob("*") if p.is_file()
    ) == sorted(mine)
    assert (root / "points" / "link").is_symlink()
    with pytest.raises(ForeignStoreError, match="contains something other than a tile store"):
        create_store(filled.url, filled.meta)


def test_remains_of_a_store_are_replaced(store_url: str, meta: StoreMeta) -> None:
    """As where somebody removed it while a run was writing a state."""
    Storage(store_url).put("state/plan.json", b"1")
    Storage(store_url).put(f"commits/filter0/{'a' * 8}.json", b"1")
    store = create_store(store_url, meta)
    assert store.get_state("plan") is None
    assert store.committed("filter0") == {}


def test_a_folder_with_a_name_of_the_layout_is_no_remains(
    store_url: str, meta: StoreMeta
) -> None:
    Storage(store_url).put("state/notes.md", b"mine")
    with pytest.raises(ForeignStoreError, match=r"something other than a tile store \(state\)"):
        create_store(store_url, meta)


def _no_points() -> PointBlock:
    return make_points(*np.empty((2, 0), np.int64))


def test_a_store_that_is_begun_anew_keeps_foreign_files(
    store_url: str, meta: StoreMeta
) -> None:
    create_store(store_url, meta, {"tile": "64"}).put_state("plan", 1)
    Storage(store_url).put("notes.txt", b"mine")
    store = create_store(store_url, FEET, {"tile": "32"}, anew=True)
    assert store.get_state("plan") is None
    again = open_store(store_url)
    assert (again.meta, again.settled) == (FEET, {"tile": "32"})
    assert Storage(store_url).get("notes.txt") == b"mine"


def test_a_store_of_an_earlier_version_can_be_begun_anew(local_store: TileStore) -> None:
    local_store.put_state("plan", 1)
    chunk = Path(local_store.url, "points", "xyz", "c", "0", "0", "0")
    chunk.parent.mkdir(parents=True)
    chunk.write_bytes(b"of schema 3")
    edit(
        Path(local_store.url, "zarr.json"),
        lambda d: d["attributes"]["tiler_store"].update(schema=3),
    )
    with pytest.raises(
        ForeignStoreError, match="store of schema 3, this version reads 6; run again with --ov"
    ):
        create_store(local_store.url, FEET)
    assert create_store(local_store.url, FEET, anew=True).get_state("plan") is None
    assert open_store(local_store.url).meta == FEET
    assert not chunk.exists()


def test_all_keys_of_a_store_are_known(filled: TileStore) -> None:
    filled.write_piece("s0", _no_points())
    filled.write_labels("labels-1", *_labels(filled))
    filled.create_raster("dtm", pixels(3, 3))
    filled.write_block("dtm", Block(0, 0, 3, 3), np.ones((3, 3), np.float32))
    filled.commit("export", "dtm.tif", "0", {})
    filled.put_state("sources", {})
    with filled.lock():
        root = Path(filled.url)
        keys = [p.relative_to(root).as_posix() for p in root.rglob("*") if p.is_file()]
        assert len(keys) > 12
        assert all(map(layout.is_ours, keys))


def _labels(store: TileStore) -> tuple[Cell, np.ndarray]:
    cell, info = next(iter(store.buckets().items()))
    return cell, np.ones(info.n, np.uint8)


def test_a_store_that_is_a_link_works(tmp_path: Path, meta: StoreMeta) -> None:
    disk, link = tmp_path / "disk", tmp_path / "store.zarr"
    link.symlink_to(disk)
    with pytest.raises(
        ForeignStoreError, match="is a link to a missing folder; make the folder"
    ):
        create_store(str(link), meta)
    disk.mkdir()
    create_store(str(link), meta).put_state("plan", 1)
    assert remove_store(str(link)) == []
    assert link.is_symlink()
    assert not list(disk.iterdir())
    create_store(str(link), meta)
    assert (disk / "zarr.json").exists()


@pytest.mark.parametrize("name", ["lock.json", "points/a.laz", "zarr.json", "zarr.json/a.laz"])
def test_a_folder_that_only_looks_like_a_store_is_not_locked(name: str, tmp_path: Path) -> None:
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text('{"attributes": {"text": "tiler_store"}}')
    with pytest.raises(ForeignStoreError), held_store(str(tmp_path)):
        pass
    with pytest.raises(ForeignStoreError):
        remove_store(str(tmp_path))
    assert [p.name for p in tmp_path.rglob("*") if p.is_file()] == [Path(name).name]
