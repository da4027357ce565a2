"""Profiles of rivers: the line falls as the levels do, all lies in the picture, and lines lie at round numbers."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiler.report.document import Node
from tiler.report.drawn import BANKS, HEIGHT, WATER, WIDTH, profile, round_steps


def river(*stations: tuple[float, float, int, float | None, float | None]) -> dict[str, Any]:
    """A river of run.json; of each station the place, the level, pixels of the water, and the levels of the banks."""
    names = ("along", "level", "seen", "left", "right")
    return {
        "kind": "river",
        "number": 3,
        "stations": [dict(zip(names, s, strict=True)) for s in stations],
    }


def line_of(picture: Node) -> list[tuple[float, ...]]:
    points = picture.find(".//polyline").get("points")  # type: ignore[union-attr]
    return [tuple(map(float, pair.split(","))) for pair in str(points).split()]


def circles(picture: Node, colour: str) -> list[tuple[float, float]]:
    found = [c for c in picture.iter("circle") if c.get("fill") == colour]
    return [(float(str(c.get("cx"))), float(str(c.get("cy")))) for c in found]


def test_the_line_falls_along_the_flow_and_marks_show_what_each_place_rests_on() -> None:
    picture = profile(
        river((0, 9.0, 40, 9.2, None), (50, 8.0, 0, 8.1, 8.0), (90, 7.5, 3, 60.0, 7.6)), "ft"
    )
    assert picture is not None
    line = line_of(picture)
    assert [x for x, _ in line] == sorted(x for x, _ in line)
    assert [y for _, y in line] == sorted(y for _, y in line)  # down the picture
    assert circles(picture, WATER) == [line[0], line[2]]
    assert len(circles(picture, BANKS)) == 4  # the cliff of 60 is too far from the water
    caption = "".join(picture.find("figcaption").itertext())  # type: ignore[union-attr]
    assert "River 3" in caption
    assert "in ft" in caption
    assert "At 2 of 3 stations" in caption


def test_a_lake_and_a_river_with_one_station_have_none() -> None:
    assert profile({"kind": "lake", "number": 1, "stations": []}, "m") is None
    assert profile(river((0, 9.0, 40, None, None)), "m") is None


@given(
    st.lists(
        st.tuples(st.floats(0, 1e4), st.floats(-50, 4000), st.integers(0, 9)),
        min_size=2,
        max_size=12,
    )
)
def test_all_that_is_drawn_lies_in_the_picture(
    stations: list[tuple[float, float, int]],
) -> None:
    picture = profile(river(*((*s, s[1] + 0.1, None) for s in sorted(stations))), "m")
    assert picture is not None
    for x, y in [*line_of(picture), *circles(picture, WATER), *circles(picture, BANKS)]:
        assert 0 < x < WIDTH
        assert 0 < y < HEIGHT


@given(st.floats(-5000, 5000), st.floats(0.5, 1e5), st.integers(2, 8))
def test_lines_lie_at_round_numbers_and_are_few(low: float, span: float, most: int) -> None:
    steps = round_steps(low, low + span, most)
    assert len(steps) <= most
    assert all(low - 1e-6 * span <= z <= low + span * (1 + 1e-6) for z in steps)


@pytest.mark.parametrize(
    ("low", "high", "steps"),
    [
        (417.17, 417.91, [417.2, 417.4, 417.6, 417.8]),
        (0.0, 1404.0, [0, 500, 1000]),
        (0.0, 10.0, [0, 5, 10]),
    ],
)
def test_examples_of_round_numbers(low: float, high: float, steps: list[float]) -> None:
    assert round_steps(low, high, 4) == pytest.approx(steps)
