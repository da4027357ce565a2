"""Places to review: what a user decided stays, and what was found to be right is not listed again."""

from __future__ import annotations

import random
from dataclasses import replace
from typing import Any

import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from tiler.core.review import (
    FAILED,
    FIXED,
    OK,
    OPEN,
    ReviewRow,
    decided_or_noted,
    is_edit,
    is_place,
    ranked,
    without_copies,
)


def row(x: float, width: float = 10.0, **values: Any) -> ReviewRow:
    shape = shapely.to_wkb(shapely.MultiPolygon([shapely.box(x, 0, x + width, 10)]), hex=True)
    return ReviewRow(shape=shape, **{"reason": "void", **values})


def listed(found: list[ReviewRow], decided: list[ReviewRow]) -> list[ReviewRow]:
    return ranked(found, decided)[0]


def test_a_place_that_was_right_is_not_listed_again() -> None:
    right = row(0, status=OK)
    assert ranked([row(0), row(100)], [right]) == ([row(100), right], [row(0)])


@pytest.mark.parametrize(("moved", "is_listed"), [(4.0, False), (6.0, True)])
def test_the_same_place_shares_half_of_its_area(moved: float, is_listed: bool) -> None:
    assert (row(moved) in listed([row(moved)], [row(0, status=OK)])) is is_listed


def test_the_first_places_have_the_largest_expected_squared_error() -> None:
    likely = row(0, chance=0.8, stake_m=1.0, area_m2=100.0)
    high = row(20, chance=0.4, stake_m=2.0, area_m2=100.0)
    wide = row(40, chance=0.1, stake_m=1.0, area_m2=1000.0)
    unknown = [row(60), row(80, chance=0.9)]
    doubtful = row(100, stake_m=1.5, area_m2=100.0)
    decided = row(120, status=FIXED, chance=1.0, stake_m=9.0, area_m2=1e6)
    assert listed([*unknown, likely, wide, doubtful, high], [decided]) == [
        high, doubtful, wide, likely, *unknown, decided,
    ]  # fmt: skip


def test_a_decision_keeps_the_chance_that_the_user_saw() -> None:
    right = row(0, status="OK", chance=0.3)
    assert decided_or_noted([right]) == [replace(right, status=OK)]


CHANCES = st.none() | st.sampled_from([0.1, 0.5, 0.9])


@given(st.lists(st.tuples(CHANCES, CHANCES), max_size=12), st.randoms())
def test_the_order_of_two_places_does_not_depend_on_the_others(
    values: list[tuple[float | None, float | None]], random: random.Random
) -> None:
    places = [row(20 * i, chance=c, stake_m=s) for i, (c, s) in enumerate(values)]
    some = [place for place in places if random.random() < 0.5]
    assert listed(some, []) == [place for place in listed(places, []) if place in some]


def test_two_parts_that_were_right_cover_a_place() -> None:
    parts = [row(0, 4, status=OK), row(4, 4, status=OK)]
    assert listed([row(0)], parts) == parts


def test_another_reason_at_the_same_place_is_listed() -> None:
    other = row(0, reason="terrain above all returns")
    assert listed([other], [row(0, status=OK)])[0] == other


def test_an_edit_that_did_not_help_leaves_its_place_open() -> None:
    fixed = row(0, status=FIXED, action="void")
    assert listed([row(0)], [fixed]) == [row(0), fixed]


def test_rows_without_a_status_are_drawn_by_the_user_and_are_edits() -> None:
    assert [is_edit(status) for status in (None, "", " Fixed ", OK, OPEN, "later")] == [
        True, True, True, False, False, False,
    ]  # fmt: skip


def test_open_rows_are_left_out_whatever_their_case() -> None:
    rows = [row(0, status=" Open"), row(1, status="OK "), row(1, status=OK), row(2, status="")]
    assert decided_or_noted(rows) == [row(1, status=OK), row(2, status=FIXED)]


def test_the_note_of_an_open_place_stays_with_it() -> None:
    earlier = decided_or_noted([row(2, note="ask"), row(50), row(60, note="it is gone")])
    assert listed([row(0), row(100)], earlier) == [row(0, note="ask"), row(100)]
    assert listed([row(0, reason="other")], earlier) == [row(0, reason="other")]


def test_a_task_that_failed_again_is_open_and_keeps_its_note() -> None:
    failed = row(0, reason=FAILED)
    decided = decided_or_noted([replace(failed, status=OK, note="bad disk")])
    assert ranked([failed], decided) == ([replace(failed, note="bad disk")], [])


def test_a_place_without_an_outline_is_not_listed() -> None:
    nothing = shapely.to_wkb(shapely.MultiPolygon([]), hex=True)
    assert listed([row(0), ReviewRow(shape=nothing, reason="void")], []) == [row(0)]


def test_a_copy_whose_outline_was_rounded_is_the_same_row() -> None:
    rows = [row(0, status=FIXED, action="void"), row(50, status=OK)]
    moved = [row(0.01, status=FIXED, action="void"), row(50.01, status=FIXED)]
    assert without_copies(rows, moved) == [row(50, status=OK)]
    assert without_copies(rows, []) == rows


@pytest.mark.parametrize(
    ("layer", "columns", "place"),
    [
        ("review", [], True),
        ("my fixes", ["rank", "reason", "stake_m"], True),
        ("edits", ["action", "rank", "status"], False),
    ],
)
def test_places_are_known_by_their_layer_or_by_their_columns(
    layer: str, columns: list[str], place: bool
) -> None:
    assert is_place(layer, columns) is place


@given(
    st.lists(st.tuples(st.integers(0, 40), st.sampled_from(["void", "roof"])), unique=True),
    st.lists(st.tuples(st.integers(0, 40), st.sampled_from([OK, FIXED, "later", ""]))),
)
def test_the_next_run_lists_the_same_and_loses_no_decision(
    found: list[tuple[int, str]], decided: list[tuple[int, str]]
) -> None:
    places = [row(x, reason=reason) for x, reason in found]
    decisions = decided_or_noted([row(x, status=status) for x, status in decided])
    rows = listed(places, decisions)
    assert rows[len(rows) - len(decisions) :] == decisions
    assert set(rows) <= {*places, *decisions}
    assert listed(places, decided_or_noted(rows)) == rows
