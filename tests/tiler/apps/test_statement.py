"""Rising pixels, random squares, answers and their bound."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chisquare

from tests.tiler.apps.check.rasters import write_heights
from tiler.apps.evaluate import rasters
from tiler.apps.statement.sample import (
    MAX_BYTES,
    SHARES,
    Sample,
    draws_needed,
    read_answers,
    sample_of,
)
from tiler.apps.statement.squares import Squares, Terrain, margin_pixels, rising
from tiler.apps.statement.writing import rounded_up, statement_text
from tiler.core.betting import upper_bound
from tiler.core.products import NODATA
from tiler.errors import InputError

FOOT = 1200 / 3937
MIXED = Squares(
    row=np.array([0, 0, 1, 2]),
    col=np.array([0, 3, 1, 2]),
    rising=np.array([1, 400, 50, 149]),
    side=20,
    pixels=10_000,
)


def rises(heights: np.ndarray, pixel_m: float = 1.0) -> np.ndarray:
    """Which pixels rise if there is no land beyond the array."""
    padded = np.pad(heights, margin_pixels(pixel_m), constant_values=np.nan)
    return rising(padded, pixel_m)[0]


def plane(east: float, south: float, shape: tuple[int, int] = (90, 110)) -> np.ndarray:
    row, col = np.indices(shape)
    return 250.0 + east * col + south * row


@st.composite
def slopes(draw: Any) -> tuple[float, float]:
    slope, angle = draw(st.floats(0, 0.4)), draw(st.floats(0, 2 * np.pi))
    return slope * np.cos(angle), slope * np.sin(angle)


@settings(max_examples=30, deadline=None)
@given(slopes(), st.integers(3, 30), st.integers(3, 30), st.integers(0, 40), st.integers(0, 40))
def test_a_box_on_a_plane_rises_and_a_plane_does_not(
    slope: tuple[float, float], width: int, height: int, row: int, col: int
) -> None:
    land = plane(*slope)
    land[60:64, 10:90] = np.nan
    assert not rises(land).any()
    # At a corner of the raster, a box may have no land on its narrow side.
    box = np.zeros(land.shape, bool)
    box[row + 10 : row + 10 + height, col + 20 : col + 20 + width] = True
    assert rises(np.where(box, land + 1.3, land))[box & np.isfinite(land)].all()


def test_objects_without_land_around_or_wider_than_the_square_do_not_rise() -> None:
    level = plane(0, 0, (200, 200))
    wide = level.copy()
    wide[40:160, 40:160] += 5
    assert not rises(wide)[80:120, 80:120].any()
    alone = np.full(level.shape, np.nan)
    alone[60:80, 60:80] = 7
    assert not rises(alone).any()


def test_damaged_heights_are_no_heights() -> None:
    land = plane(0.1, 0)
    expected = land.copy()
    land[5, 5], land[6, 7], expected[5, 5], expected[6, 7] = 3e38, np.inf, np.nan, np.nan
    assert np.array_equal(rises(land), rises(expected))


def hills(seed: int, shape: tuple[int, int]) -> np.ndarray:
    """Rough land with voids, of heights as in files."""
    rng = np.random.default_rng(seed)
    row, col = np.indices(shape)
    heights = 400 + 9 * np.sin(row / 17) * np.cos(col / 23) + rng.normal(0, 0.5, shape)
    heights[30:90, 100:140] = heights[:, :3] = np.nan
    return heights.astype(np.float32)


def written(path: Path, heights: np.ndarray, pixel: float = 1.0) -> Path:
    return write_heights(
        path, np.nan_to_num(heights, nan=NODATA), 500_000, 5_400_000, pixel, "EPSG:25832"
    )


@pytest.mark.parametrize("pixel_m", [1.0, 3.7, 70.0])
def test_blocks_have_the_pixels_of_the_whole(
    pixel_m: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shape = (257, 231)
    heights = hills(2, shape)
    with rasterio.open(written(tmp_path / "dtm.tif", heights)) as raster:
        terrain = Terrain(raster, pixel_m, 1.0)
        whole, is_there = terrain.rising(0, 0, *shape)
        assert 100 < whole.sum() < is_there.sum() == np.isfinite(heights).sum()
        assert np.array_equal(whole, rises(heights.astype(float), pixel_m))
        expected = terrain.squares()
        monkeypatch.setattr(rasters, "BLOCK", 61)
        squares = terrain.squares()
        for row in range(0, 257, 61):
            for col in range(0, 231, 61):
                size = min(61, 257 - row), min(61, 231 - col)
                part, there = terrain.rising(row, col, *size)
                window = slice(row, row + 61), slice(col, col + 61)
                assert np.array_equal(part, whole[window])
                assert np.array_equal(there, is_there[window])
    assert expected.digest("a") == squares.digest("a") != squares.digest("b")
    side = expected.side
    assert side == max(round(20 / pixel_m), 1)
    padded = np.pad(whole, [(0, -n % side) for n in shape])
    sums = padded.reshape(padded.shape[0] // side, side, -1, side).sum(axis=(1, 3))
    assert np.array_equal(sums[squares.row, squares.col], squares.rising)
    assert squares.all_rising == whole.sum()
    assert squares.pixels == is_there.sum()


def test_the_unit_of_pixels_and_heights_is_regarded(tmp_path: Path) -> None:
    heights = hills(4, (120, 150))
    with (
        rasterio.open(written(tmp_path / "m.tif", heights)) as metres,
        rasterio.open(
            written(tmp_path / "ft.tif", heights.astype(float) / FOOT, 1 / FOOT)
        ) as feet,
    ):
        expected = Terrain(metres, 1.0, 1.0).squares()
        found = Terrain(feet, 1 / FOOT * FOOT, FOOT).squares()
    # Heights of files are float32.
    assert found.all_rising == pytest.approx(expected.all_rising, rel=0.01)
    assert found.pixels == expected.pixels


def test_outlines_are_the_rising_pixels_of_a_square(tmp_path: Path) -> None:
    with rasterio.open(written(tmp_path / "dtm.tif", hills(5, (130, 150)), 0.5)) as raster:
        terrain = Terrain(raster, 0.5, 1.0)
        squares = terrain.squares()
        for index in range(squares.rising.size):
            shape, square = terrain.outline(squares, index)
            assert shape.area == pytest.approx(squares.rising[index] * 0.25)
            assert square.covers(shape)
            assert square.bounds[0] == 500_000 + 20 * squares.col[index]
            assert square.bounds[3] == 5_400_000 - 20 * squares.row[index]


def test_draws_have_the_probabilities_of_the_rising_pixels() -> None:
    number = 6000
    drawn = [MIXED.drawn("key", draw) for draw in range(1, number + 1)]
    counts = np.bincount(drawn, minlength=4)
    assert chisquare(counts, MIXED.rising / MIXED.rising.sum() * number).pvalue > 1e-3
    other = [MIXED.drawn("other", draw) for draw in range(1, number + 1)]
    assert 0.3 < np.mean(np.equal(drawn, other)) < 0.7


def test_further_answers_do_not_change_the_draws_before() -> None:
    many = Squares(
        np.arange(500), np.zeros(500, int), np.arange(1, 501), side=20, pixels=200_000
    )
    first = sample_of(many, "key", {}, 10)
    assert next(iter(first.todo.values())) == 1
    assert sample_of(many, "key", {}, 60).todo.items() >= first.todo.items()
    answers = dict.fromkeys(first.todo.values(), 0.0)
    second = sample_of(many, "key", answers, 10)
    assert min(second.todo.values()) > max(first.todo.values())
    assert len(second.shares) == min(second.todo.values()) - 1
    assert second.max_pixels == upper_bound(second.shares) * many.all_rising
    gap = {draw: share for draw, share in answers.items() if draw != 3}
    third = sample_of(many, "key", gap, 10)
    assert (len(third.shares), third.waiting) == (2, len(gap) - 2)
    assert min(third.todo.values()) == 3


def test_one_answer_is_for_all_draws_of_a_square_and_all_squares_are_certain() -> None:
    drawn = [MIXED.drawn("key", draw) for draw in range(1, 2000)]
    first = {index: drawn.index(index) + 1 for index in set(drawn)}
    assert sorted(first) == [0, 1, 2, 3]
    assert sample_of(MIXED, "key", {}, 50).todo == first
    shares = {0: 1.0, 1: 0.0, 2: 0.5, 3: 0.25}
    sample = sample_of(MIXED, "key", {first[i]: shares[i] for i in first}, 50)
    assert not sample.todo
    assert sample.shares == tuple(shares[i] for i in drawn[: max(first.values())])
    assert sample.max_pixels == 1 + 25 + 149 / 4
    # The larger of two answers to a square counts.
    again = drawn.index(1, first[1]) + 1
    both = sample_of(MIXED, "key", {first[1]: 0.25, again: 0.75}, 50)
    assert both.max_pixels <= 0.75 * 400 + 200


@given(st.lists(st.sampled_from([0.0, 0.25, 0.5, 0.75, 1.0]), min_size=1, max_size=40))
def test_the_bound_is_never_below_what_was_found(answers: list[float]) -> None:
    shares = dict(enumerate(answers, start=1))
    sample = sample_of(MIXED, "key", shares, 50)
    largest: dict[int, float] = {}
    for draw, share in shares.items():
        index = MIXED.drawn("key", draw)
        largest[index] = max(share, largest.get(index, 0.0))
    found = sum(share * int(MIXED.rising[i]) for i, share in largest.items())
    assert sample.max_pixels >= found
    if sample.seen == sample.squares:
        assert sample.max_pixels == pytest.approx(found)


@pytest.mark.parametrize("share", [0.5, 0.1, 0.013])
def test_as_many_draws_are_needed_as_the_bound_asks(share: float) -> None:
    number = draws_needed(share)
    assert upper_bound(number * [0.0]) <= share < upper_bound((number - 1) * [0.0])


def test_the_text_has_the_figures() -> None:
    sample = Sample((0.0, 0.25, 0.0), 2, {7: 4}, 5, 90, 1234.5)
    text = statement_text(sample, 520_000, 31_000, 1.0, (1.0, 1.0))
    assert text == (
        "at most 1,300 m2 of objects that rise by 1 m or more, up to 40 m wide, are left in 0.52 km2 of terrain, "
        "of which 31,000 m2 rises above the land around, 95 % sure (3 random draws, 1 with objects); "
        "2 later answers will count once all squares before are answered"
    )
    feet = statement_text(sample, 520_000, 31_000, FOOT**2, (FOOT, FOOT))
    assert feet.startswith("at most 1,300 ft2 of objects that rise by 3.28 ft (1 m) or more, ")
    assert "are left in 11.9 acres of terrain" in feet
    every = Sample((0.0,), 0, {}, 90, 90, 0.0)
    assert "at most 0 m2" in statement_text(every, 520_000, 31_000, 1.0, (1.0, 1.0))
    assert "every square that rises was looked at (90)" in statement_text(
        every, 520_000, 31_000, 1.0, (1.0, 1.0)
    )
    none = Sample((), 0, {7: 1}, 0, 9000, 31_000.0)
    text = statement_text(none, 520_000, 31_000, 1.0, (1.0, 1.0))
    assert f"{draws_needed(10_000 / 31_000)} for at most 10,000 m2, " in text
    assert f"{draws_needed(1000 / 31_000)} for at most 1,000 m2" in text
    few = Sample((), 0, {7: 1}, 0, 5, 31_000.0)
    assert "look at all 5 squares" in statement_text(few, 520_000, 31_000, 1.0, (1.0, 1.0))
    later = Sample((), 2, {7: 1}, 2, 9000, 31_000.0)
    text = statement_text(later, 520_000, 31_000, 1.0, (1.0, 1.0))
    assert text.startswith("no answer counts yet: ")
    assert text.endswith("; 2 later answers will count once all squares before are answered")
    assert "no square to look at" in statement_text(None, 520_000, 0, 1.0, (1.0, 1.0))


@given(st.floats(0, 1e12))
def test_bounds_are_rounded_up_to_two_digits(number: float) -> None:
    rounded = rounded_up(number)
    assert number <= rounded <= max(1.1 * number * (1 + 1e-9), number + 1)
    assert len(str(rounded).rstrip("0")) <= 2


def saved(path: Path, content: Any) -> Path:
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_answers_are_read(tmp_path: Path) -> None:
    shares = dict(zip(map(str, range(1, 6)), SHARES.values(), strict=True))
    path = saved(tmp_path / "answers.json", {"sample": "k", "answers": shares})
    assert read_answers(path) == ("k", {1: 0.0, 2: 0.25, 3: 0.5, 4: 0.75, 5: 1.0})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is not a file of answers"),
        ("\udc80", "is not a file of answers"),
        ("[" * 100_000, "nested too deeply"),
        ([1], "not a JSON object"),
        ({"answers": {}}, "is not a file of answers"),
        ({"sample": "k", "answers": [1]}, "is not a file of answers"),
        ({"sample": "k", "answers": {"0": 0}}, "'0' is not a number of a draw"),
        ({"sample": "k", "answers": {"1" * 5000: 0}}, "is not a number of a draw"),
        ({"sample": "k", "answers": {"100001": 0}}, "is not a number of a draw"),
        ({"sample": "k", "answers": {"٣": 0}}, "is not a number of a draw"),
        ({"sample": "k", "answers": {"1": True}}, "draw 1: True is not an answer"),
        ({"sample": "k", "answers": {"1": 0.1}}, "draw 1: 0.1 is not an answer"),
        ({"sample": "k", "answers": {"1": float("nan")}}, "draw 1: nan is not an answer"),
        ({"sample": "k", "answers": {"1": [0]}}, r"draw 1: \[0\] is not an answer"),
        ('{"sample": "k", "answers": {"7": 0, "7": 1}}', r"answers.json: .*the key '7' is repeated"),
        ('{"sample": "k", "sample": "l", "answers": {}}', "the key 'sample' is repeated"),
        (" " * (MAX_BYTES + 1), "has more than 4 MiB"),
    ],
)  # fmt: skip
def test_damaged_answers_are_refused_in_one_line(
    content: Any, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "answers.json"
    if content == "\udc80":
        path.write_bytes(b'{"sample": "\x80"}')
    else:
        saved(path, content)
    with pytest.raises(InputError, match=message) as error:
        read_answers(path)
    assert "\n" not in str(error.value)
    assert "give the file of answers that the page saved" in str(error.value)


def test_answers_that_are_not_there_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.json", tmp_path):
        with pytest.raises(InputError, match="is no file"):
            read_answers(path)
