"""An object of the store that is damaged or gone is found, and what wrote it is done again: the bytes are the same."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.invariants.runs import do, output_digests
from tests.scenes.damages import DAMAGES, flip
from tiler.errors import StoreError
from tiler.export import classified
from tiler.io.las.reader import PointReader
from tiler.store import open_store

CHUNKS = {
    "points": ("points/xyz/c.*.0.0", {"spool": 0}),
    "origins": ("points/origin/c.*.0.0", {"spool": 0}),
    "labels": ("labels/labels/c.*.0.0", {"spool": 0, "assemble": 0}),
    "raster": (
        "rasters/dtm-outlined/c.*.*",
        {"filter0": 0, "grid-dtm": 0, "grid-dtm-outlined": 1},
    ),
}
WHOLE = {
    "index": "index/*.npy",
    "index pointer": "index/current.json",
    "column": "points/attributes/zarr.json",
    "all labels": "labels/labels/zarr.json",
    "the raster": "rasters/dtm/zarr.json",
}


@pytest.fixture
def out(city_run: Path, tmp_path: Path) -> Path:
    """A finished run without its files, so that they are made from the store again."""
    shutil.copytree(city_run, tmp_path / "out")
    (tmp_path / "out" / "dtm.tif").unlink()
    shutil.rmtree(tmp_path / "out" / "classified")
    return tmp_path / "out"


@pytest.mark.parametrize("damaged", [False, True])
def test_a_source_is_decoded_again_only_where_its_records_are_damaged(
    damaged: bool, city: Path, city_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    decoded = []
    monkeypatch.setattr(
        classified, "PointReader", lambda *a, **k: decoded.append(a) or PointReader(*a, **k)
    )
    do(city, tmp_path, until="ingest")
    (chunk,) = (tmp_path / "store.zarr").glob("records/*/c.0.0")
    if damaged:
        flip(chunk)
    assert do(city, tmp_path).exit_code == 0
    assert output_digests(tmp_path) == output_digests(city_run)
    assert len(decoded) == damaged
    assert not chunk.exists()


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("kind", CHUNKS)
def test_a_damaged_chunk_is_made_again(
    kind: str, damage: str, city: Path, city_run: Path, out: Path
) -> None:
    pattern, redone = CHUNKS[kind]
    DAMAGES[damage](max((out / "store.zarr").glob(pattern), key=lambda p: p.stat().st_size))
    # A new resolution needs the labels and points again, which the files alone may not.
    result = do(city, out)
    assert result.exit_code == 0
    assert output_digests(out) == output_digests(city_run)
    for stage, tasks in redone.items():
        assert result.summary["stages"][stage]["computed"] == tasks


@pytest.mark.parametrize(
    ("pattern", "cleared"),
    [
        ("points/xyz/c.*", "grid-dtm"),  # Files that are missing need no positions of points.
        ("points/origin/c.*", None),
        ("labels/labels/c.*", None),
        ("rasters/dtm*/c.*", None),
    ],
)
def test_chunks_at_each_others_place_are_made_again(
    pattern: str, cleared: str | None, city: Path, city_run: Path, out: Path
) -> None:
    if cleared is not None:
        open_store(str(out / "store.zarr")).clear(cleared)
    chunks = sorted((out / "store.zarr").glob(pattern))
    one, other = chunks[0], chunks[-1]
    first, second = one.read_bytes(), other.read_bytes()
    assert first != second
    one.write_bytes(second)
    other.write_bytes(first)
    result = do(city, out)
    assert result.exit_code == 0
    assert result.summary["healed"]
    assert output_digests(out) == output_digests(city_run)


@pytest.mark.parametrize("kind", WHOLE)
def test_what_is_damaged_as_a_whole_is_made_again(
    kind: str, city: Path, city_run: Path, out: Path
) -> None:
    flip(next((out / "store.zarr").glob(WHOLE[kind])))
    result = do(city, out)
    assert result.exit_code == 0
    assert output_digests(out) == output_digests(city_run)
    assert result.summary["stages"]["spool"]["computed"] == 0


def test_a_damaged_spool_is_decoded_again(city: Path, city_run: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    do(city, out, until="ingest")
    shutil.rmtree(out / "store.zarr" / "commits" / "assemble")
    flip(max((out / "store.zarr" / "spool").rglob("c.*.0"), key=lambda p: p.stat().st_size))
    result = do(city, out)
    assert result.summary["healed"]
    assert output_digests(out) == output_digests(city_run)


def test_a_raster_that_is_made_at_once_is_made_again(city: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    do(city, out, products=("dtm", "mask"))
    mask = (out / "mask.tif").read_bytes()
    (out / "mask.tif").unlink()
    store = open_store(str(out / "store.zarr"))
    store.clear("grid-mask")
    flip(next((out / "store.zarr").glob("rasters/survey/c.*.*")))
    result = do(city, out, products=("dtm", "mask"))
    assert result.summary["healed"]
    assert (out / "mask.tif").read_bytes() == mask


def test_a_disk_that_damages_everything_ends_the_run(
    city: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tiler.store import points

    write = points.write_rows

    def damaging(array, bucket, values):  # type: ignore[no-untyped-def]
        write(array, bucket, values)
        for path in Path(array.storage.url, array.path).glob("c.*"):
            flip(path)

    monkeypatch.setattr(points, "write_rows", damaging)
    with pytest.raises(StoreError, match="damaged or missing; run again"):
        do(city, tmp_path / "out")
