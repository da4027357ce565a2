"""Classes in the clouds that a run writes: the ground is new, all else is the producer's."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import laspy
import numpy as np
import pytest
import shapely

from tests.invariants import clouds
from tests.invariants.clouds import CORNER
from tests.invariants.runs import computed, do, settings, stored_labels, the_store
from tests.scenes.drawings import draw
from tiler.apps.classify import classify_file
from tiler.io.result_folder import RUN
from tiler.observe.events import Event, Note

SIDE = 80.0
POND = shapely.box(10, 10, 60, 60)
NO_PART = (7, 9, 17, 18)
WRITTEN_AGAIN = "classified clouds of an earlier version are written again"


def written(path: Path, point_format: int, classes: np.ndarray | None = None) -> Path:
    """A city whose points have their true classes, but for some that other programs use."""
    cloud = clouds.city(SIDE)
    found = np.where(np.arange(len(cloud)) % 11 == 0, np.arange(len(cloud)) % 32, cloud.truth)
    clouds.write(path, cloud, classes=found.astype(np.uint8) if classes is None else classes)
    if point_format != 6:
        laspy.convert(laspy.read(path), point_format_id=point_format).write(path)
    return path


def classes_of(path: Path) -> np.ndarray:
    return np.asarray(laspy.read(path).classification)


def expected(before: np.ndarray, labels: np.ndarray, wet: np.ndarray) -> list[int]:
    """The table of the issue, point by point."""

    def of(before: int, label: int, wet: bool) -> int:
        if before in NO_PART:
            return before
        if label == 7:
            return 7
        if label == 2:
            return 9 if wet else 2
        if before in (0, 1, 2):
            return 9 if wet else 1
        return before

    return [
        of(*point) for point in zip(before.tolist(), labels.tolist(), wet.tolist(), strict=True)
    ]


@pytest.mark.parametrize("point_format", [1, 6])
@pytest.mark.parametrize("form", ["laz", "copc"])
def test_a_run_keeps_the_classes_of_objects(
    tmp_path: Path, point_format: int, form: str
) -> None:
    cloud, out = written(tmp_path / "a.laz", point_format), tmp_path / "out"
    drawn, low = (
        draw(tmp_path / "pond.json", [(POND, {"kind": "lake"})]),
        "noise" if form == "laz" else "keep",
    )
    result = do(cloud, out, water=drawn, water_low=low, classified=form)
    las = laspy.read(cloud)
    before, labels = classes_of(cloud), stored_labels(out)[0]
    wet = shapely.contains_xy(POND, las.x - CORNER[0], las.y - CORNER[1])
    level = json.loads((out / "run.json").read_text())["water"][0]["level"]
    above = wet & (labels == 1) & (las.z > level + 1)
    below = wet & (labels != 0) & (np.asarray(las.z) < level - 0.4995)
    assert above.any()
    assert below.any()
    labels = np.where(below & (low == "noise"), 7, labels)
    wet &= ~above  # trees and roofs over the water
    wanted = np.array(expected(before, labels, wet))
    made = laspy.read(out / "classified" / ("a.laz" if form == "laz" else "a.copc.laz"))
    order = np.argsort(made.gps_time)  # COPC has them by place
    after = np.asarray(made.classification)[order]

    assert (after == wanted).all()
    assert {1, 2, 3, 5, 6, 9, 12, 19, 31} <= set(after.tolist())
    assert ((before == 6) & (after == 2)).any()  # what the filter takes for ground is ground
    stays = (labels == 1) & (before > 2)
    facts = result.summary["classes"]
    assert facts["reclass"] == "ground"
    assert facts["kept"] == {
        str(c): int(n) for c, n in enumerate(np.bincount(before[stays])) if n
    }
    assert facts["written"] == {str(c): int(n) for c, n in enumerate(np.bincount(after)) if n}
    assert facts["input"] == {str(c): int(n) for c, n in enumerate(np.bincount(before)) if n}
    (line,) = [
        note for note in result.notes if note.startswith("classes of the input are kept")
    ]
    assert f"{facts['kept']['5']:,} of class 5" in line
    assert "(--reclass all gives them class 1)" in line
    assert f"{facts['no_part']['9']} of class 9" in line
    assert "points that keep class 5 of the input" in (out / "report.html").read_text()


def test_all_gives_each_point_the_class_that_was_found(tmp_path: Path) -> None:
    cloud, out = written(tmp_path / "a.laz", 6), tmp_path / "out"
    water = draw(tmp_path / "pond.json", [(POND, {"kind": "lake"})])
    do(cloud, out, water=water)
    first = (out / "classified" / "a.laz").read_bytes()
    result = do(cloud, out, water=water, reclass="all")
    assert {name: n for name, n in computed(result).items() if n} == {
        "export": 1,
        "catalogue": 1,
    }
    before, labels = classes_of(cloud), stored_labels(out)[0]
    assert (
        classes_of(out / "classified" / "a.laz").tolist()
        == np.where(labels, labels, before).tolist()
    )
    assert result.summary["classes"]["kept"] == {}
    do(cloud, out, water=water)
    assert (out / "classified" / "a.laz").read_bytes() == first


def test_a_class_that_keeps_many_points_out_is_told(tmp_path: Path) -> None:
    """In one survey class 17 was overlap of flight lines."""
    many = np.where(np.arange(len(clouds.city(SIDE))) % 4 == 0, 17, 1).astype(np.uint8)
    many[::30] = 9
    cloud = written(tmp_path / "a.laz", 6, many)
    result = do(cloud, tmp_path / "out")
    n = np.count_nonzero(many == 17)
    told = [note for note in result.notes if "are not filtered, so they keep it" in note]
    (line,) = told  # of class 9 there are few
    assert line.startswith(f"{n / len(many):.1%} of the points ({n:,}) are of class 17")
    assert "use --keep-classes 7,9,18 to filter them" in line
    taken = do(cloud, tmp_path / "out", keep_classes="7,9,18")
    assert taken.summary["filter"]["points"] - taken.summary["filter"][
        "kept"
    ] == np.count_nonzero(many != 9)
    assert not any("are not filtered, so they keep it" in note for note in taken.notes)
    only = do(cloud, tmp_path / "only", keep_classes="17")
    assert any("--keep-classes none to filter" in note for note in only.notes)
    trusted = do(cloud, tmp_path / "trusted", method="keep", ground_classes="1")
    assert not any("are not filtered, so they keep it" in note for note in trusted.notes)


@pytest.mark.parametrize("left", ["store", "run.json"])
def test_clouds_of_an_earlier_version_are_told_of_and_written_anew(
    tmp_path: Path, left: str
) -> None:
    cloud, out = written(tmp_path / "a.laz", 6), tmp_path / "out"
    first = do(cloud, out)
    assert not any(WRITTEN_AGAIN in note for note in first.notes)
    after = (out / "classified" / "a.laz").read_bytes()
    if left == "store":
        store = the_store(out)
        (_, record) = store.committed("export")["c000000"]
        store.commit(
            "export", "c000000", "another", {k: v for k, v in record.items() if k != "kept"}
        )
    else:
        shutil.rmtree(out / "store.zarr")
        run = json.loads((out / RUN).read_text())
        del run["configuration"]["reclass"]
        (out / RUN).write_text(json.dumps(run))
    (out / "classified" / "a.laz").write_bytes(b"what that version wrote")
    again = do(cloud, out)
    assert any(WRITTEN_AGAIN in note for note in again.notes)
    assert (out / "classified" / "a.laz").read_bytes() == after
    if left == "store":
        assert computed(again)["filter0"] == computed(again)["grid-dtm"] == 0
    assert not any(WRITTEN_AGAIN in note for note in do(cloud, out).notes)


def test_classify_keeps_them_too(tmp_path: Path) -> None:
    cloud, told = written(tmp_path / "a.laz", 1), []
    config = settings(keep_classes="7,9,17,18,31")

    def listen(event: Event) -> None:
        if isinstance(event, Note):
            told.append(event.text)

    facts = classify_file(cloud, tmp_path / "b.laz", config, listen)
    before, after = classes_of(cloud), classes_of(tmp_path / "b.laz")
    assert (after[before == 31] == 31).all()
    stays = (after == before) & ~np.isin(before, (0, 1, 2, *NO_PART, 31))
    assert facts["kept"] == {
        str(c): int(n) for c, n in enumerate(np.bincount(before[stays])) if n
    }
    assert set(after[~stays & (before > 2)].tolist()) <= {2, *NO_PART, 31}
    assert any(text.startswith("classes of the input are kept") for text in told)
    classify_file(cloud, tmp_path / "c.laz", config.updated(reclass="all"))
    assert set(classes_of(tmp_path / "c.laz").tolist()) <= {1, 2, *NO_PART, 31}
