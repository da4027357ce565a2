"""Green leaf index, modes and Otsu's threshold, compared with numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from ptd.methods.dong2017.histograms import (
    BINS,
    COLOURLESS,
    GREY,
    gli_bins,
    green_from,
    index_of_bin,
    otsu,
    smoothed,
    two_modes,
)

GLI = [
    ((100, 100, 100), 0.0),
    ((0, 255, 0), 1.0),
    ((255, 0, 0), -1.0),
    ((255, 0, 255), -1.0),
    ((60, 120, 60), 1 / 3),
    ((90, 140, 60), 130 / 430),
    ((1, 2, 1), 1 / 3),
]


@pytest.mark.parametrize(("colour", "index"), GLI)
@pytest.mark.parametrize("times", [1, 256, 257])
def test_gli_of_a_colour_in_8_and_16_bits(
    colour: tuple[int, int, int], index: float, times: int
) -> None:
    """GLI = (2G - R - B) / (2G + R + B) in any range."""
    found = gli_bins(np.array(colour, np.uint16)[:, None] * np.uint16(times))
    assert found.tolist() == [min(int((index + 1) / 2 * BINS + 1e-9), BINS - 1)]


def test_black_has_no_colour() -> None:
    assert gli_bins(np.zeros((3, 2), np.uint16)).tolist() == [COLOURLESS, COLOURLESS]


def test_bins_cover_minus_one_to_one() -> None:
    assert [index_of_bin(k) for k in (0, GREY, BINS)] == [-1.0, 0.0, 1.0]


def test_smoothing_keeps_a_symmetric_peak_and_the_sum() -> None:
    counts = [0] * 9
    counts[4] = 1
    found = smoothed(counts)
    assert found == [1, 8, 28, 56, 70, 56, 28, 8, 1]  # binomials of 8
    assert sum(found) == 16**2


OTSU = [
    # Any split between two separate modes is equally good, so the lowest is taken.
    ([4, 4, 0, 0, 4, 4], 2),
    # By hand for 5, 3, 0, 2: n 10, moments 0, 3, 0, 6, mean 0.9. Split after 0: 5 and 5 points,
    # means 0 and 1.8, variance 0.5 0.5 1.8^2 = 0.81; after 1 or 2: 8 and 2, means 3/8 and 3,
    # variance 0.8 0.2 2.625^2 = 1.1025.
    ([5, 3, 0, 2], 2),
    # 6, 1, 1: after 0: 6/8, 2/8, means 0, 1.5: 0.421875; after 1: 7/8, 1/8, means 1/7, 2:
    # 0.377.
    ([6, 1, 1], 1),
]


@pytest.mark.parametrize(("counts", "first"), OTSU)
def test_otsu_by_hand(counts: list[int], first: int) -> None:
    assert otsu(counts) == first


def bell(centre: float, width: float, n: int) -> np.ndarray:
    return np.rint(n * np.exp(-0.5 * ((np.arange(BINS) - centre) / width) ** 2)).astype(int)


def test_grey_and_green_modes_are_found_and_split_between() -> None:
    counts = (bell(GREY + 1, 2, 9000) + bell(GREY + 14, 3, 2000)).tolist()
    modes = two_modes(counts)
    assert modes == (GREY + 1, GREY + 14)
    found = green_from(counts)
    assert found is not None
    assert GREY + 1 < found < GREY + 14
    assert found == modes[0] + otsu(counts[modes[0] : modes[1] + 1])


UNIMODAL = {
    "one bell": bell(GREY, 4, 9000),
    "all green": bell(GREY + 12, 5, 9000),
    "a tail without a mode": bell(GREY, 3, 9000) + bell(GREY + 6, 5, 2500),
    "one bin": np.eye(BINS, dtype=int)[GREY] * 500,
    "flat": np.full(BINS, 7),
    "a green mode of a few points": bell(GREY, 3, 9000) + bell(GREY + 30, 2, 20),
    "empty": np.zeros(BINS, int),
}


@pytest.mark.parametrize("name", UNIMODAL)
def test_no_split_without_two_modes(name: str) -> None:
    """Otsu's threshold would split each of these histograms."""
    assert green_from(UNIMODAL[name].tolist()) is None


def test_two_modes_that_are_not_green_are_not_split() -> None:
    """The modes are red roofs and grey streets."""
    assert green_from((bell(GREY - 20, 3, 5000) + bell(GREY - 2, 3, 5000)).tolist()) is None


def test_red_grey_and_green_are_split_at_green() -> None:
    counts = (
        bell(GREY - 20, 3, 9000) + bell(GREY - 1, 2, 9000) + bell(GREY + 20, 3, 3000)
    ).tolist()
    found = green_from(counts)
    assert found is not None
    assert GREY + 4 < found < GREY + 16


def test_gaps_of_dark_8_bit_colours_are_not_valleys() -> None:
    """Dark grey values have few ratios."""
    rng = np.random.default_rng(1)
    colours = np.clip(rng.normal(14, 1.5, (3, 50_000)).round(), 1, 255).astype(np.uint16)
    counts = np.bincount(gli_bins(colours), minlength=BINS)
    assert (counts[GREY - 3 : GREY + 4] == 0).any() or counts[
        GREY - 3 : GREY + 4
    ].min() < counts.max() / 3
    assert green_from(counts.tolist()) is None
