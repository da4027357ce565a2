"""Specifications: those that come with tiler, files, and what is refused."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.tiler.apps.acceptance.pulses import Pulses, lattice
from tiler.apps.acceptance import (
    are_clouds,
    check_clouds,
    read_specification,
    specification_names,
)
from tiler.apps.acceptance.rows import ROWS
from tiler.errors import ConfigError

DOCS = Path(__file__).parents[4] / "docs" / "acceptance.md"


def test_the_quality_levels_of_usgs_have_their_spacing_and_density() -> None:
    limits = {name: read_specification(name).limits for name in specification_names()}
    density = {name: asked["pulse_density"] for name, asked in limits.items()}
    assert density == {"usgs-ql0": 8, "usgs-ql1": 8, "usgs-ql2": 2}
    assert limits["usgs-ql2"]["pulse_spacing"] == 0.71
    assert all(v["distribution"] == 90 for v in limits.values())


def test_a_cloud_may_meet_one_quality_level_and_fail_another(tmp_path: Path) -> None:
    swaths = Pulses(*lattice(0, 60, 0, 60), 1) + Pulses(*lattice(40, 100, 0, 60), 2)
    path = swaths.write(tmp_path / "a.laz")
    good = check_clouds([path], read_specification("usgs-ql2"))
    assert good["met"], [r for r in good["rows"] if r["state"] not in ("pass", "not asked")]
    bad = check_clouds([path], read_specification("usgs-ql1"))
    assert not bad["met"]
    failed = {row["name"] for row in bad["rows"] if row["state"] == "fail"}
    # Cells of 0.7 m hold one or two pulses of 0.5 m on each side, so that none is empty.
    assert failed == {"pulse_density"}


def test_a_row_that_is_asked_but_not_measured_is_not_met(tmp_path: Path) -> None:
    path = Pulses(*lattice(0, 60, 0, 60), 0).write(tmp_path / "a.laz")
    asked = tmp_path / "asked.toml"
    asked.write_text("swath_gaps = 0\nduplicates = 0\n")
    summary = check_clouds([path], read_specification(str(asked)))
    states = {r["name"]: r["state"] for r in summary["rows"] if r["state"] != "not asked"}
    assert states == {"swath_gaps": "not measured", "duplicates": "pass"}
    assert not summary["met"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("densty = 2", "densty is not a row of the check"),
        ("pulse_densty = 2", "did you mean pulse_density?"),
        ("pulse_density = 'much'", "must be a number of 0 or above"),
        ("pulse_density = -1", "must be a number of 0 or above"),
        ("pulse_density = 0", "must be above 0"),
        ("pulse_density = true", "must be a number of 0 or above"),
        ("pulse_spacing = '2 parsec'", "unknown unit 'parsec'"),
        ("distribution = 0.9", "must be a percentage above 1"),
        ("gps_time = ['adjusted']", "choose from adjusted standard, week seconds, none"),
        ("classes = 2", "must be a list of values like [1, 2]"),
        ("las_version = [1.4]", 'must be a list of values like ["1.4"]'),
        ("", "asks for nothing"),
        ("pulse_density", "not valid TOML"),
    ],
)
def test_a_wrong_specification_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "asked.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=re.escape(message)) as error:
        read_specification(str(path))
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)


def test_lengths_and_areas_may_have_units(tmp_path: Path) -> None:
    path = tmp_path / "asked.toml"
    path.write_text('pulse_spacing = "2ft"\nvoid_area = "1 acre"\n')
    limits = read_specification(str(path)).limits
    assert limits == {
        "pulse_spacing": pytest.approx(0.6096),
        "void_area": pytest.approx(4046.856, abs=0.001),
    }


def test_an_unknown_name_lists_the_names() -> None:
    with pytest.raises(ConfigError, match="choose one of usgs-ql0, usgs-ql1, usgs-ql2"):
        read_specification("usgs-ql9")


def test_each_row_is_documented() -> None:
    text = DOCS.read_text("utf-8")
    for row in ROWS:
        assert f"| `{row.name}` | {row.limit} | {row.unit} | {row.meaning} |" in text


def test_clouds_are_told_from_terrains(tmp_path: Path) -> None:
    clouds = tmp_path / "clouds"
    (clouds / "deep").mkdir(parents=True)
    assert not are_clouds([str(clouds)])
    (clouds / "deep" / "a.laz").touch()
    dtm = tmp_path / "dtm.tif"
    dtm.touch()
    for text in (str(clouds), f"{clouds}/*/*.laz", "x.LAS", "x.vpc", "https://a.b/c.laz?t=1"):
        assert are_clouds([text])
    for text in (str(dtm), str(tmp_path / "out"), f"{tmp_path}/*.tif", "https://a.b/c.tif"):
        assert not are_clouds([text])
    with pytest.raises(ConfigError, match="is not a cloud"):
        are_clouds([str(clouds), str(dtm)])
