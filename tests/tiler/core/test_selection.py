from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiler.core.selection import (
    EVERY_POINT,
    Selection,
    parse_angle,
    parse_numbers,
    parse_returns,
    parse_sources,
)
from tiler.errors import ConfigError
from tiler.ingest.spool import unselected

# Return and number of returns, scan angle, source id and class of six points.
RETURNS = np.array([[1, 1, 2, 3, 0, 2], [1, 3, 3, 3, 0, 2]], np.uint8)
ANGLES = np.array([0, -19.9, 20, 20.1, -31, 5], np.float32)
SOURCES = np.array([1, 2, 3, 12, 0, 65_535], np.uint16)
CLASSES = np.array([1, 2, 3, 7, 18, 2], np.uint8)


@pytest.mark.parametrize(
    ("selection", "left_out"),
    [
        (Selection(returns="first"), [2, 3, 5]),
        (Selection(returns="last"), [1, 2]),
        (Selection(returns="2-3"), [0, 1, 4]),
        (Selection(scan_angle_deg=20.0), [3, 4]),
        (Selection(source_ids="1,3-12"), [1, 4, 5]),
        (Selection(drop_classes=(7, 18)), [3, 4]),
    ],
)
def test_each_option_leaves_out_what_it_names(
    selection: Selection, left_out: list[int]
) -> None:
    (mask,) = unselected(selection, RETURNS, ANGLES, SOURCES, CLASSES).values()
    assert np.flatnonzero(mask).tolist() == left_out


def test_without_options_every_point_is_selected() -> None:
    assert unselected(EVERY_POINT, RETURNS, ANGLES, SOURCES, CLASSES) == {}


def test_options_say_what_the_user_wrote() -> None:
    selection = Selection("last", 20.0, "12,20-31", (7, 18))
    assert list(selection.options.values()) == [
        "--returns last",
        "--scan-angle 20",
        "--source-id 12,20-31",
        "--drop-classes 7,18",
    ]
    assert (
        selection.options.keys()
        == unselected(selection, RETURNS, ANGLES, SOURCES, CLASSES).keys()
    )


@given(st.sets(st.integers(0, 255), min_size=1))
def test_numbers_and_ranges_are_read_back(numbers: set[int]) -> None:
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    text = ", ".join(f"{first}-{last}" for first, last in runs)
    assert parse_numbers(text, "classes", 0, 255) == tuple(sorted(numbers))
    assert parse_numbers(sorted(numbers), "classes", 0, 255) == tuple(sorted(numbers))


def test_lists_of_toml_are_what_the_command_line_has() -> None:
    assert parse_sources([12, 13]) == "12,13"
    assert parse_returns([1, "3-4"]) == "1,3-4"


@pytest.mark.parametrize(
    ("parse", "value", "message"),
    [
        (parse_returns, "middle", "give numbers or ranges separated by commas"),
        (parse_returns, "", "are not returns; give first, last, or numbers"),
        (parse_returns, "0", "returns out of range; give 1 to 15"),
        (parse_returns, "3-2", "runs backwards; use 2-3"),
        (parse_sources, "70000", "point source ids out of range; give 0 to 65535"),
        (parse_sources, ",", "are not point source ids"),
        (parse_angle, "wide", "is not an angle; give degrees, like 20"),
        (parse_angle, "0", "above 0 and at most 180"),
        (parse_angle, "nan", "above 0 and at most 180"),
    ],
)
def test_what_is_wrong_is_said_with_the_remedy(parse: Any, value: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse(value)
