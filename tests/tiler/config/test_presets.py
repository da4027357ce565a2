"""Every preset is a file of valid settings with reasons; options and files win over it."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import pytest

from cli.options import read_config
from ptd.methods import make_params
from tiler.config import RunConfig
from tiler.config.sources import load_preset, preset_names, preset_text
from tiler.errors import ConfigError

NAMES = ("als", "city", "dim", "forest", "mountain", "swiss", "usgs")


def test_all_presets_exist() -> None:
    assert preset_names() == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_each_preset_is_valid_and_says_what_it_is_for(name: str) -> None:
    config = RunConfig.from_mapping({"preset": name})
    make_params(config.method, dict(config.parameters))
    lines = preset_text(name).splitlines()
    assert lines[0].startswith("# ")
    assert load_preset(name)
    assert config.preset == name
    assert RunConfig.from_mapping(config.to_json()) == config


@pytest.mark.parametrize(
    ("name", "kind"), [("als", "lidar"), ("city", "lidar"), ("dim", "dim"), ("usgs", None)]
)
def test_only_presets_for_one_kind_of_cloud_set_the_kind(name: str, kind: str | None) -> None:
    assert RunConfig.from_mapping({"preset": name}).source_kind == kind
    assert RunConfig.from_mapping({"preset": name, "kind": "dim"}).source_kind == "dim"


def test_the_specification_of_usgs() -> None:
    config = RunConfig.from_mapping({"preset": "usgs"})
    assert (config.nodata, config.resolution) == (-999999.0, 1)
    assert config.keep_classes == (7, 9, 17, 18, 20, 21, 22)
    assert not config.skip_overlap


def test_sheets_of_a_kilometre_in_switzerland() -> None:
    config = RunConfig.from_mapping({"preset": "swiss"})
    assert (config.resolution, config.sheets) == (Fraction(1, 2), (1000, 1000))


def test_order_is_default_preset_file_option(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text('nodata = -32768\nkeep_classes = [7]\npreset = "swiss"\n', "utf-8")
    found = read_config({"preset": "usgs", "config_file": file, "keep_classes": "18"})
    assert found.preset == "usgs"  # the option's, not the file's
    assert found.nodata == -32768  # the file's
    assert found.keep_classes == (18,)  # the option's
    assert found.resolution == 1  # the preset's
    assert found.compress == RunConfig().compress
    assert read_config({"config_file": file}).sheets == (1000, 1000)  # a file can name a preset


def test_parameters_of_a_preset_go_with_its_method(monkeypatch: pytest.MonkeyPatch) -> None:
    base = {"method": "chen2023", "parameters": {"max_building_size": 60, "rounds": 5}}
    monkeypatch.setattr("tiler.config.sources.load_preset", lambda name: {**base})
    assert dict(RunConfig.from_mapping({"preset": "x"}).parameters) == {
        "max_building_size": "60",
        "rounds": "5",
    }
    one = RunConfig.from_mapping({"preset": "x", "parameters": {"max_building_size_m": 30}})
    assert dict(one.parameters) == {"max_building_size_m": "30", "rounds": "5"}
    assert RunConfig.from_mapping({"preset": "x", "method": "classic"}).parameters == ()


def test_an_unknown_preset_is_refused_with_the_names() -> None:
    with pytest.raises(ConfigError, match="preset 'alps': choose one of als, city"):
        RunConfig.from_mapping({"preset": "alps"})


@pytest.mark.parametrize(
    ("value", "error"),
    [
        ("many", "not a number"),
        (0, "could be a height"),
        (-0.5, "could be a height"),
        (8848.0, "could be"),
        (-9999.1, "cannot hold it exactly"),
        (1e300, "cannot hold"),
        ([1], "a number"),
    ],
)
def test_a_nodata_value_that_misleads_is_refused(value: object, error: str) -> None:
    with pytest.raises(ConfigError, match=error):
        RunConfig.from_mapping({"nodata": value})


@pytest.mark.parametrize("value", [-9999, "-999999", -32768.0, -3.4028234663852886e38])
def test_the_usual_nodata_values_are_taken(value: object) -> None:
    assert RunConfig.from_mapping({"nodata": value}).nodata == float(value)  # type: ignore[arg-type]
