"""Pairs of references and clouds, and scores over many scenes."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning

from tests.tiler.apps.evaluate.clouds import write_cloud
from tiler.apps.evaluate import (
    MapRequest,
    Scene,
    evaluate_scenes,
    filter_and_evaluate,
    find_scenes,
)
from tiler.config import RunConfig
from tiler.errors import ConfigError
from tiler.schedule import FORKS, fork_server


def square(n: int = 6) -> np.ndarray:
    """n x n points, one per unit, beginning at (100.5, 200.5)."""
    x, y = (v.ravel() for v in np.meshgrid(np.arange(n), np.arange(n)))
    return np.column_stack((100.5 + x, 200.5 + y, np.zeros(n * n)))


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    truth = np.full(36, 2, np.uint8)
    for name in ("x", "y"):
        for kind, classes in (("mine", np.where(np.arange(36) < 6, 1, 2)), ("true", truth)):
            (tmp_path / kind / name).mkdir(parents=True)
            write_cloud(tmp_path / kind / name / "a.laz", square(), classes.astype(np.uint8))
        truth = np.full(36, 6, np.uint8)
    return tmp_path / "mine", tmp_path / "true"


def pairs(scenes: list[Scene]) -> list[tuple[str, str]]:
    return [
        (s.cloud.parent.name + s.cloud.stem, s.reference.parent.name + s.reference.stem)
        for s in scenes
    ]


def test_folders_are_paired_by_place(folders: tuple[Path, Path]) -> None:
    scenes = find_scenes([folders[0]], [folders[1]])
    assert pairs(scenes) == [("xa", "xa"), ("ya", "ya")]
    assert [s.name for s in scenes] == ["x_a", "y_a"]


def test_files_are_paired_by_order(folders: tuple[Path, Path]) -> None:
    mine, true = ([f / n / "a.laz" for n in ("x", "y")] for f in folders)
    scenes = find_scenes(mine, true[::-1])
    assert pairs(scenes) == [("xa", "ya"), ("ya", "xa")]
    assert [s.name for s in scenes] == ["a-1", "a-2"]


def test_one_cloud_has_all_references(folders: tuple[Path, Path]) -> None:
    assert pairs(find_scenes([folders[0] / "x"], [folders[1]])) == [("xa", "xa"), ("xa", "ya")]


def test_a_reference_without_cloud_is_refused(folders: tuple[Path, Path]) -> None:
    (folders[1] / "x" / "a.laz").rename(folders[1] / "x" / "b.laz")
    with pytest.raises(
        ConfigError, match=r"b\.laz: none of the 2 clouds is named b; give references the names"
    ):
        find_scenes([folders[0]], [folders[1]])


def test_scores_of_each_scene_of_all_points_and_their_mean(folders: tuple[Path, Path]) -> None:
    facts = evaluate_scenes(find_scenes([folders[0]], [folders[1]]))
    one, other = facts["scenes"]
    assert (one["type_1"], one["type_2"], other["type_1"], other["type_2"]) == (
        6 / 36,
        None,
        None,
        30 / 36,
    )
    assert facts["total"] == facts["mean"]["total"] == 36 / 72
    assert (facts["type_1"], facts["type_2"], facts["points"]) == (6 / 36, 30 / 36, 72)
    assert facts["classes"]["6"] == {
        "points": 36,
        "labelled_ground": 30,
        "wrong": 30,
        "error": 30 / 36,
    }


def test_a_map_shows_the_places_of_errors(tmp_path: Path) -> None:
    truth = np.where(square()[:, 0] < 103, 2, 6).astype(np.uint8)
    # ground lost in the south-west
    labels = np.where(square()[:, 1] < 202, 1, truth).astype(np.uint8)
    labels[-1] = 2  # an object in the north-east
    truth[30] = 7  # the north-west is left out
    cloud, reference = (
        write_cloud(tmp_path / f"{name}.laz", square(), classes)
        for name, classes in (("a", labels), ("b", truth))
    )
    facts = evaluate_scenes(
        [Scene("s", cloud, reference)], maps=MapRequest(tmp_path / "maps", Fraction(2))
    )
    tif, png = (Path(path) for path in facts["scenes"][0]["maps"])
    with rasterio.open(tif) as raster:
        assert raster.transform[:6] == (2, 0, 100, 0, -2, 206)
        code, lost, taken = raster.read()
    # The column at x = 102 to 104 is half ground, half object.
    assert code.tolist() == [[0, 0, 2], [0, 0, 0], [1, 1, 0]]
    assert lost.tolist() == [[0, 0, 0], [0, 0, 0], [100, 50, 0]]
    assert taken.tolist() == [[0, 0, 25], [0, 0, 0], [0, 0, 0]]
    with pytest.warns(NotGeoreferencedWarning):
        picture = rasterio.open(png)
    with picture:
        assert picture.shape == (3, 3)
        red, green, blue, opacity = picture.read()
    assert red[2, 0] > 2 * blue[2, 0]
    assert blue[0, 2] > 2 * red[0, 2]
    assert opacity.min() == 255


def test_cells_without_judged_points_are_transparent(tmp_path: Path) -> None:
    xyz = np.array([[0.5, 0.5, 0.0], [2.5, 0.5, 0.0]])
    cloud = write_cloud(tmp_path / "a.laz", xyz, np.array([2, 2], np.uint8))
    facts = evaluate_scenes([Scene("s", cloud, cloud)], maps=MapRequest(tmp_path))
    with rasterio.open(facts["scenes"][0]["maps"][0]) as raster:
        assert raster.read(1).tolist() == [[0, 255, 0]]
    noise = write_cloud(tmp_path / "n.laz", xyz, np.array([7, 7], np.uint8))
    assert (
        evaluate_scenes([Scene("n", noise, noise)], maps=MapRequest(tmp_path))["scenes"][0][
            "maps"
        ]
        == []
    )


def test_a_filter_does_not_see_the_classes(tmp_path: Path) -> None:
    """Labels do not depend on the classes of the labelled cloud; noise, water and ground take part alike."""
    rng = np.random.default_rng(2)
    xyz = np.column_stack((rng.uniform(0, 60, (4000, 2)), rng.normal(0, 0.03, 4000)))
    house = np.all(np.abs(xyz[:, :2] - 30) < 5, axis=1)
    xyz[house, 2] += 6
    truth = np.where(house, 6, 2).astype(np.uint8)
    lying = rng.choice(np.array([2, 7, 9, 17, 18], np.uint8), 4000)
    scores = {}
    for name, classes in (("true", truth), ("lying", lying)):
        path = write_cloud(tmp_path / f"{name}.laz", xyz, classes)
        scores[name] = filter_and_evaluate([path], RunConfig(in_process=True), ignore=())
    assert scores["true"]["total"] < 0.01
    found = {
        name: sum(c["labelled_ground"] for c in s["classes"].values())
        for name, s in scores.items()
    }
    assert found["true"] == found["lying"]
    assert scores["true"]["scenes"][0]["seconds"] > 0
    assert scores["true"]["method"] == "auto"
    assert laspy.read(tmp_path / "lying.laz").classification.tolist() == lying.tolist()


@pytest.mark.processes
@pytest.mark.skipif(not FORKS, reason="children are no forks of a server")
def test_scenes_share_one_server_of_forks(
    folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[object] = []

    class Counted(fork_server._Server):
        def __init__(self, setting: tuple[object, ...]) -> None:
            started.append(setting)
            super().__init__(setting)

    monkeypatch.setattr(fork_server, "_Server", Counted)
    found = evaluate_scenes(find_scenes([folders[0]], [folders[1]]))
    assert len(found["scenes"]) == 2
    assert len(started) == 1
