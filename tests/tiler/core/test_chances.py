"""Chances of places to review: measured shares, and the loss by which places are ranked."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiler.core.chances import (
    LEAST_PLACES,
    LIDAR,
    PHOTOGRAMMETRIC,
    REASONS,
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
    chance = chance_from(places, wrong)
    assert chance is not None
    first, last = sorted((0.5, wrong / places))
    assert first - 0.005 <= chance <= last + 0.005


def test_few_places_tell_no_chance() -> None:
    assert chance_from(LEAST_PLACES - 1, LEAST_PLACES - 1) is None
    assert chance_from(8 * LEAST_PLACES, 0) == pytest.approx(
        1 / (8 * LEAST_PLACES + 2), abs=0.005
    )


def test_a_chance_is_that_of_the_reason_and_the_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(
        REASONS, "shed", Reason(measured={LIDAR: (98, 89), PHOTOGRAMMETRIC: (3, 3)})
    )
    assert chance_of("shed", LIDAR) == 0.9
    assert chance_of("shed", PHOTOGRAMMETRIC) is None
    assert chance_of("shed", None) is None
    assert chance_of("an unknown reason", LIDAR) is None


def test_counts_are_possible_and_certain_results_have_no_chance() -> None:
    for reason in REASONS.values():
        assert not (reason.is_certain and reason.measured)
        assert set(reason.measured) <= {LIDAR, PHOTOGRAMMETRIC}
        assert all(0 <= wrong <= places for places, wrong in reason.measured.values())
        if reason.measured or reason.is_certain:
            assert reason.error_m is not None


def test_the_loss_is_the_expected_squared_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(REASONS, "shed", Reason(2.0))
    monkeypatch.setitem(REASONS, "hole", Reason(2.0, is_certain=True))
    assert expected_loss("shed", 0.5, 3.0, 10.0) == 0.5 * 9 * 10
    assert expected_loss("shed", 0.5, None, 10.0) == 0.5 * 4 * 10
    assert expected_loss("shed", None, 3.0, 10.0) is None
    assert expected_loss("an unknown reason", 0.5, None, 10.0) is None
    assert expected_loss("an unknown reason", 0.5, 1.0, 10.0) == 5.0
    assert expected_loss("hole", None, None, 10.0) == 40.0
