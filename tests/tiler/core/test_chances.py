"""Chances of places to review: measured shares, and the loss by which places are ranked."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiler.core.chances import (
    LEAST_PLACES,
    LIDAR,
    PHOTOGRAMMETRIC,
    REASONS,
    Counts,
    Reason,
    chance_from,
    chance_of,
    expected_loss,
)


@given(st.integers(LEAST_PLACES, 10_000), st.data())
def test_a_chance_lies_between_the_measured_share_and_one_half(
    places: int, data: st.DataObject
) -> None:
    wrong = data.draw(st.integers(0, places))
    chance = chance_from([Counts(places, wrong)], 0)
    assert chance is not None
    first, last = sorted((0.5, wrong / places))
    assert first - 0.005 <= chance <= last + 0.005


def test_few_places_tell_no_chance() -> None:
    few = LEAST_PLACES - 1
    assert chance_from([], 0) is None
    assert chance_from([Counts(few, few)], 0) is None
    assert chance_from([Counts(3, 1), Counts(few - 3, 1)], 1) is None


def test_a_size_with_few_places_has_nearly_the_mean_of_all() -> None:
    none, few, many = ([Counts(98, 29), Counts(n, n)] for n in (0, 1, 400))
    assert chance_from(none, 1) == 0.3
    assert 0.3 < (chance_from(few, 1) or 0) < 0.5
    assert chance_from(many, 1) == 1.0


def test_a_chance_is_that_of_the_reason_the_kind_and_the_size(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sizes = {LIDAR: [Counts(500, 50), Counts(500, 450)], PHOTOGRAMMETRIC: [Counts(3, 3)]}
    monkeypatch.setitem(REASONS, "shed", Reason(measured=sizes, large_m2=200.0))
    assert chance_of("shed", LIDAR, 199.0) == chance_of("shed", LIDAR) == 0.1
    assert chance_of("shed", LIDAR, 200.0) == 0.9
    assert chance_of("shed", PHOTOGRAMMETRIC, 9.0) is None
    assert chance_of("shed", None) is None
    assert chance_of("an unknown reason", LIDAR) is None


def test_counts_are_possible_and_certain_results_have_no_chance() -> None:
    for reason in REASONS.values():
        assert not (reason.is_certain and reason.measured)
        assert set(reason.measured) <= {LIDAR, PHOTOGRAMMETRIC}
        for sizes in reason.measured.values():
            assert len(sizes) == (1 if reason.large_m2 is None else 2)
            assert all(0 <= counts.wrong <= counts.places for counts in sizes)
        if any(counts.wrong for sizes in reason.measured.values() for counts in sizes):
            assert reason.error_m is not None


def test_the_loss_is_the_expected_squared_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(REASONS, "shed", Reason(2.0))
    monkeypatch.setitem(REASONS, "hole", Reason(2.0, is_certain=True))
    assert expected_loss("shed", 0.5, 3.0, 10.0) == 0.5 * 9 * 10
    assert expected_loss("shed", 0.5, None, 10.0) == 0.5 * 4 * 10
    assert expected_loss("shed", None, 3.0, 10.0) == 0.5 * 9 * 10
    assert expected_loss("an unknown reason", 0.5, None, 10.0) is None
    assert expected_loss("an unknown reason", 0.5, 1.0, 10.0) == 5.0
    assert expected_loss("hole", None, None, 10.0) == 40.0


def test_the_documentation_has_the_measured_places() -> None:
    text = Path(__file__).parents[3].joinpath("docs", "review.md").read_text("utf-8")
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()]
    told = {row[0]: row[1:] for row in rows if len(row) == 3}
    for name, reason in REASONS.items():
        for size in range(0 if not reason.measured else 1 if reason.large_m2 is None else 2):
            sizes = ("below", "at least")
            limit = "" if reason.large_m2 is None else f", {sizes[size]} {reason.large_m2:g} m2"
            area = reason.large_m2 if size else None
            assert told[name + limit] == [
                _told(name, kind, area, size) for kind in (LIDAR, PHOTOGRAMMETRIC)
            ]


def _told(name: str, kind: str, area_m2: float | None, size: int) -> str:
    measured = REASONS[name].measured.get(kind)
    if measured is None:
        return "-"
    chance = chance_of(name, kind, area_m2)
    text = f"{measured[size].wrong} of {measured[size].places}"
    return text if chance is None else f"{text}: {chance:.2f}"
