"""The setting `sheets`: one side, width x height, or the name of a file."""

from __future__ import annotations

from fractions import Fraction

import pytest

from tiler.config import RunConfig
from tiler.errors import ConfigError


@pytest.mark.parametrize(
    ("given", "sides", "written"),
    [
        ("1km", (1000, 1000), "1000"),
        (500, (500, 500), "500"),
        ("1000x1250", (1000, 1250), "1000x1250"),
        ("2 x 1/3", (2, Fraction(1, 3)), "2x1/3"),
    ],
)
def test_sides_are_kept_in_a_file_of_settings(
    given: object, sides: tuple[Fraction, Fraction], written: str
) -> None:
    config = RunConfig.from_mapping({"sheets": given})
    assert config.sheets == sides
    assert config.to_json()["sheets"] == written
    assert RunConfig.from_mapping(config.to_json()) == config
    assert (config.sheet_file, config.sheet_template) == (None, "{name}_{x}_{y}")


@pytest.mark.parametrize(
    "name", ["box.gpkg", "2024.shp", "data/1x2.geojson", "./1000", "../1x2", "/1000", ".\\1000"]
)
def test_a_text_with_the_suffix_of_a_file_or_the_beginning_of_a_path_is_a_file(
    name: str,
) -> None:
    config = RunConfig.from_mapping({"sheets": name, "sheet_field": "n"})
    assert (config.sheets, config.sheet_file) == (name, name)
    assert config.sheet_template == "{name}_{sheet}"
    assert RunConfig.from_mapping(config.to_json()) == config


@pytest.mark.parametrize("text", ["wide", "0", "1000x0", "-5", "10x", "1.5.5"])
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"^sheets"):
        RunConfig.from_mapping({"sheets": text})
