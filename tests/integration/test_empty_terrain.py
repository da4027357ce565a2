"""A terrain without any height: the run gives the true reason."""

from __future__ import annotations

import shutil
from pathlib import Path

import laspy
import numpy as np
import pytest

from cli.summary import summary_lines
from tests.invariants.runs import do, settings
from tiler.observe.events import Event, Warned
from tiler.pipeline import run
from tiler.report.problems import problems_of
from tiler.report.sections import figures
from tiler.simulate import DemoScene


def test_a_terrain_without_a_height_is_warned_of(demo: DemoScene, tmp_path: Path) -> None:
    told: list[str] = []

    def listen(event: Event) -> None:
        if isinstance(event, Warned):
            told.append(event.text)

    (tmp_path / "in").mkdir()
    shutil.copy(demo.truth_paths[0], tmp_path / "in")
    (tmp_path / "in" / "page.laz").write_text("<html>")
    result = run(
        [str(tmp_path / "in")],
        tmp_path / "out",
        settings(method="keep", ground_classes="99"),
        listen,
    )
    assert result.exit_code == 5
    assert any("page.laz: left out: begins with b'<htm'" in text for text in told)
    assert any(
        "the terrain model is empty: no point has class 99; the classes of the clouds are 1 ("
        in text
        for text in told
    )
    assert told[-1] in result.summary["notes"]


def test_a_cloud_of_nothing_but_noise_says_why_there_is_no_terrain(
    demo: DemoScene, tmp_path: Path
) -> None:
    cloud = laspy.read(demo.truth_paths[0])
    cloud.points = cloud.points[:500]
    cloud.classification = np.full(500, 7, dtype=np.uint8)
    cloud.write(tmp_path / "noise.las")
    notes = do([tmp_path / "noise.las"], tmp_path / "out").summary["notes"]
    assert any("none of the 500 points takes part in the filter" in text for text in notes)
    assert any(text.endswith("--keep-classes none filters the classes too") for text in notes)


@pytest.mark.parametrize("method", ["auto", "keep"])
def test_withheld_ground_of_the_input_is_not_ground_of_the_run(
    method: str, demo: DemoScene, tmp_path: Path
) -> None:
    cloud = laspy.read(demo.truth_paths[0])
    cloud.points = cloud.points[:500]
    cloud.classification = np.full(500, 2, dtype=np.uint8)
    cloud.withheld = np.ones(500, dtype=np.uint8)
    cloud.write(tmp_path / "withheld.las")
    summary = do([tmp_path / "withheld.las"], tmp_path / "out", method=method).summary
    told = "the terrain model is empty: the flag withheld excludes all 500 points; use --withheld keep"
    assert told in summary["notes"]
    assert problems_of(summary)[0][:3] == ("empty terrain model", None, told)
    if method == "auto":
        assert (summary["classes"]["written"], summary["classes"]["ground"]) == ({"2": 500}, 0)
        lines = summary_lines(summary, "OUT")
        assert "ground      0 points, in 1 tile" in lines
        assert dict(figures(summary))["ground points"] == "0.0%"


@pytest.mark.parametrize(
    "direction", [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.4, -1.0)], ids=str
)
def test_points_on_a_line_are_the_reason_for_an_empty_terrain(
    direction: tuple[float, float], demo: DemoScene, tmp_path: Path
) -> None:
    cloud = laspy.read(demo.truth_paths[0])
    cloud.points = cloud.points[:500]
    west, south = cloud.header.mins[:2]
    along = np.linspace(0, 80, 500)
    cloud.x, cloud.y = west + along * direction[0], south + along * direction[1]
    cloud.write(tmp_path / "line.las")
    notes = do([tmp_path / "line.las"], tmp_path / "out", kind="als").summary["notes"]
    told = (
        "all 500 points lie on one line (within 0.5 m of it); a terrain needs points of an area"
    )
    assert f"the terrain model is empty: {told}" in notes


def test_far_points_of_an_area_are_not_on_a_line(demo: DemoScene, tmp_path: Path) -> None:
    cloud = laspy.read(demo.truth_paths[0])
    cloud.points = cloud.points[:3]
    west, south = cloud.header.mins[:2]
    cloud.x, cloud.y = west + np.array([0, 50, 100]), south + np.array([0, 50, 0])
    cloud.write(tmp_path / "far.las")
    config = {"kind": "als", "max_edge": "10", "resolution": "1"}
    notes = do([tmp_path / "far.las"], tmp_path / "out", **config).summary["notes"]
    assert any("no three ground points lie within --max-edge 10 m" in text for text in notes)
