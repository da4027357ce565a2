"""The thin cloud of all classified clouds, which QGIS draws while it shows them from afar."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from shapely import box

from tests.invariants import clouds
from tests.invariants.runs import computed, do
from tests.scenes.drawings import draw
from tiler.apps.delivery import deliver, verify
from tiler.errors import ProcessingError
from tiler.export import overview
from tiler.export.tasks import outdated
from tiler.inputs import find_inputs
from tiler.io.result_folder import OVERVIEW
from tiler.runs.job import Job

SIDE_M = 100.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A city in two files. A strip and its points are in both, and one of them has other classes there."""
    folder = tmp_path_factory.mktemp("clouds")
    city = clouds.city(SIDE_M, 2.0)
    for name, side in (("west", city.xyz[:, 0] < 55), ("east", city.xyz[:, 0] >= 45)):
        part = city.take(side)
        classes = np.where(part.truth == 6, 6, 1 if name == "west" else 5).astype(np.uint8)
        clouds.write(folder / f"{name}.laz", part, classes=classes)
    return folder


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> int:
    """Largest number of points of an overview in the tests, with which the cells are wider than 1 m."""
    monkeypatch.setattr(overview, "MIN_POINTS", 900)
    monkeypatch.setattr(overview, "MAX_POINTS", 900)
    return 900


def points(path: Path) -> np.ndarray:
    """Position in millimetres, class, and returns of each point, shape (n, 6)."""
    las = laspy.read(path)
    columns = (las.classification, las.return_number, las.number_of_returns)
    return np.column_stack(
        (np.rint(las.xyz * 1000).astype(np.int64), *map(np.asarray, columns))
    )


def classified(out: Path) -> np.ndarray:
    return np.concatenate([points(path) for path in sorted((out / "classified").iterdir())])


def assets(out: Path) -> list[dict[str, Any]]:
    features = json.loads((out / "classified.vpc").read_text("utf-8"))["features"]
    return [feature["assets"] for feature in features]


@pytest.mark.parametrize("form", ["laz", "copc"])
def test_it_has_a_point_of_the_clouds_in_each_cell(
    form: str, folder: Path, few: int, tmp_path: Path
) -> None:
    do(folder, tmp_path, classified=form)
    (href,) = {each["overview"]["href"] for each in assets(tmp_path)}
    assert [each["overview"]["roles"] for each in assets(tmp_path)] == 2 * [["overview"]]
    assert all(next(iter(each)) == "data" for each in assets(tmp_path))
    path = tmp_path / href
    assert path == tmp_path / OVERVIEW
    found, whole = points(path), classified(tmp_path)
    assert set(map(tuple, found.tolist())) <= set(map(tuple, whole.tolist()))
    assert {2, 6} < set(found[:, 3].tolist())
    assert few / 4 < len(found) <= few
    (side,) = (
        side
        for side in (1000 * 2**n for n in range(12))
        if len(np.unique(whole[:, :2] // side, axis=0)) == len(found)
    )
    cells = found[:, :2] // side
    assert np.array_equal(np.unique(cells, axis=0), np.unique(whole[:, :2] // side, axis=0))
    with laspy.CopcReader.open(str(path)) as reader:
        assert reader.header.point_count == len(found) == len(reader.query())
        assert reader.header.parse_crs().to_epsg() == 32632
        for axis in range(2):
            ends = [reader.header.mins[axis], reader.header.maxs[axis]]
            assert abs(whole[:, axis].min() / 1000 - ends[0]) < side / 1000
            assert abs(whole[:, axis].max() / 1000 - ends[1]) < side / 1000


@pytest.mark.usefixtures("few")
def test_equal_clouds_have_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    """For any order of the files, any size of tiles and buckets, and after a removal of the file."""
    first = do(folder, tmp_path / "a")
    content = (tmp_path / "a" / OVERVIEW).read_bytes()
    assert first.summary["outputs"][OVERVIEW] == len(content)
    assert do(folder, tmp_path / "a").did_nothing
    (tmp_path / "a" / OVERVIEW).unlink()
    assert computed(do(folder, tmp_path / "a"))["export"] == 1
    assert (tmp_path / "a" / OVERVIEW).read_bytes() == content
    for old, new in (("west", "1"), ("east", "2")):
        (tmp_path / "other").mkdir(exist_ok=True)
        (tmp_path / "other" / f"{new}.laz").write_bytes((folder / f"{old}.laz").read_bytes())
    do(tmp_path / "other", tmp_path / "b", tile_size="32", memory="2GiB")
    assert (tmp_path / "b" / OVERVIEW).read_bytes() == content


@pytest.mark.usefixtures("few")
def test_it_has_the_classes_after_an_edit(folder: Path, tmp_path: Path) -> None:
    do(folder, tmp_path)
    before = points(tmp_path / OVERVIEW)
    edits = draw(tmp_path / "edits.geojson", [(box(20, 20, 80, 80), {"action": "not_ground"})])
    do(folder, tmp_path, edits=edits)
    after = points(tmp_path / OVERVIEW)
    assert set(map(tuple, before[:, :3].tolist())) == set(map(tuple, after[:, :3].tolist()))
    assert (after[:, 3] == 2).sum() < (before[:, 3] == 2).sum()
    assert set(map(tuple, after.tolist())) <= set(map(tuple, classified(tmp_path).tolist()))


def test_one_cloud_or_none_has_no_overview(folder: Path, tmp_path: Path) -> None:
    do(folder, tmp_path)
    assert (tmp_path / OVERVIEW).is_file()
    do(folder, tmp_path, classified="none")
    assert not (tmp_path / OVERVIEW).exists()
    assert (tmp_path / "outdated" / OVERVIEW).is_file()
    do(folder / "west.laz", tmp_path / "one")
    assert not (tmp_path / "one" / OVERVIEW).exists()
    assert "overview" not in assets(tmp_path / "one")[0]


def test_an_overview_of_other_clouds_is_moved_if_there_is_one_cloud_now(
    folder: Path, tmp_path: Path
) -> None:
    do(folder, tmp_path)
    before = (tmp_path / OVERVIEW).read_bytes()
    do(folder / "west.laz", tmp_path)
    assert not (tmp_path / OVERVIEW).exists()
    assert (tmp_path / "outdated" / OVERVIEW).read_bytes() == before
    assert "overview" not in assets(tmp_path)[0]


def test_an_earlier_overview_is_moved_if_the_new_one_cannot_be_written(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    do(folder, tmp_path)
    before = (tmp_path / OVERVIEW).read_bytes()

    def fails(*arguments: Any) -> None:
        raise ProcessingError("no")

    how = {"parameters": {"iteration_distance": "0.2"}}
    with monkeypatch.context() as patch:
        patch.setattr(overview, "new_file", fails)
        result = do(folder, tmp_path, **how)
    assert result.exit_code == 5
    assert not (tmp_path / OVERVIEW).exists()
    assert (tmp_path / "outdated" / OVERVIEW).read_bytes() == before
    assert OVERVIEW not in result.summary["outputs"].keys() | result.summary["earlier_outputs"]
    assert [each for each in assets(tmp_path) if "overview" in each] == []
    assert [text for text in result.summary["notes"] if text.startswith(f"{OVERVIEW}: ")]
    assert do(folder, tmp_path, **how).exit_code == 0
    assert set(map(tuple, points(tmp_path / OVERVIEW).tolist())) <= set(
        map(tuple, classified(tmp_path).tolist())
    )


def test_a_part_of_the_clouds_has_an_overview_of_that_part(
    folder: Path, tmp_path: Path
) -> None:
    east, north = clouds.CORNER
    bounds = (east + 30, north + 30, east + 70, north + 70)
    do(folder, tmp_path, bounds=bounds)
    found = points(tmp_path / OVERVIEW)
    assert len(found) > 1000
    assert (found[:, :2] >= np.multiply(bounds[:2], 1000)).all()
    assert (found[:, :2] <= np.multiply(bounds[2:], 1000)).all()
    assert set(map(tuple, found.tolist())) <= set(map(tuple, classified(tmp_path).tolist()))


def test_a_later_run_does_not_read_it_and_a_delivery_has_it(
    folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "project" / "out"
    do(folder, out)
    mine = tmp_path / "project" / "mine.laz"
    mine.write_bytes((folder / "west.laz").read_bytes())
    assert find_inputs([out.parent]) == [mine]
    assert find_inputs([f"{out.parent}/**/*.laz"]) == [mine]
    written = sorted((out / "classified").iterdir())
    assert find_inputs([out], results=True) == find_inputs([out / "classified"]) == written
    assert find_inputs([out / "classified.vpc"]) == written
    assert find_inputs([out / OVERVIEW]) == [out / OVERVIEW]
    deliver(out, tmp_path / "to")
    delivered = sorted((tmp_path / "to" / "classified").iterdir())
    assert find_inputs([tmp_path / "to"]) == delivered
    entries = json.loads((tmp_path / "to" / "manifest.json").read_text())["files"]
    (entry,) = (entry for entry in entries if entry["path"] == OVERVIEW)
    assert (entry["kind"], entry["points"]) == ("cloud", len(points(out / OVERVIEW)))
    assert not verify(tmp_path / "to").changed


def test_an_overview_that_cannot_be_moved_either_does_not_end_the_run(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = outdated.archive

    def held(job: Job, paths: Sequence[str]) -> str:
        if OVERVIEW in paths:
            raise ProcessingError("in use")
        return archive(job, paths)

    def fails(*arguments: Any) -> None:
        raise ProcessingError("no")

    do(folder, tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(overview, "new_file", fails)
        patch.setattr(outdated, "archive", held)
        result = do(folder, tmp_path, parameters={"iteration_distance": "0.2"})
    assert result.exit_code == 5
    assert [text for text in result.summary["notes"] if "nor move it (in use)" in text]
    assert (tmp_path / OVERVIEW).exists()
    assert "classified.vpc" in result.summary["outputs"]
