"""What the fields of points say about what made their cloud."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ptd
from ptd import Evidence
from ptd.matched.evidence import (
    COLOUR,
    DIM,
    LIDAR,
    MAX_CONFIDENCE,
    Piece,
    concluded,
    decided_by,
)

N = 500
RNG = np.random.default_rng(1)
ONE = np.ones((N, 2), np.uint8)
NONE = np.zeros(N, np.uint16)
RGB = RNG.integers(0, 200, (N, 3)).astype(np.uint16)
DRONE: dict[str, Any] = {
    "returns": ONE, "gps_time": NONE, "scan_angle": NONE, "source_id": NONE, "intensity": NONE, "rgb": RGB,
}  # fmt: skip
NO_COLOUR = np.zeros((N, 3))


@pytest.mark.parametrize(
    ("changed", "kind"),
    [
        ({}, DIM),
        ({"intensity": RGB.sum(axis=1)}, DIM),  # the grey of the colours
        ({"returns": np.repeat(np.where(np.arange(N) % 3, 1, 2)[:, None], 2, axis=1)}, LIDAR),
        ({"gps_time": np.arange(N) / 7, "intensity": RNG.integers(1, 99, N)}, LIDAR),
        ({"scan_angle": np.arange(N) % 9, "rgb": NO_COLOUR}, LIDAR),
        ({"flags": (np.arange(N) % 2,), "rgb": NO_COLOUR}, LIDAR),
        ({"intensity": RNG.integers(1, 99, N), "rgb": NO_COLOUR}, LIDAR),
        # What follows is left to the places of the points.
        ({"intensity": RNG.integers(1, 99, N)}, None),
        ({"rgb": NO_COLOUR}, None),
        ({"gps_time": np.full(N, 3.0), "rgb": NO_COLOUR}, None),
        ({"gps_time": np.full(N, np.nan), "rgb": NO_COLOUR}, None),
        # painted with intensities
        ({"rgb": np.repeat(RGB[:, :1], 3, axis=1), "intensity": RGB[:, 0]}, None),
    ],
)
def test_fields_decide_where_they_are_clear(changed: dict[str, Any], kind: str | None) -> None:
    made = decided_by(Evidence.of(**(DRONE | changed)))
    assert (made and made.kind) == kind
    assert made is None or (made.sure or 0) >= 0.9


def test_colours_alone_do_not_decide() -> None:
    assert decided_by(Evidence.of(rgb=RGB)) is None
    assert decided_by(Evidence()) is None
    assert Evidence.of() == Evidence()


def test_weights_are_logarithms_of_odds() -> None:
    made = concluded(
        [Piece(COLOUR, "a"), Piece(0.1, "b"), Piece(0.2, "c"), Piece(-0.3, "against")]
    )
    assert made.kind == DIM
    assert made.sure == pytest.approx(math.exp(2.4) / (1 + math.exp(2.4)))
    assert made.why == "a; c"
    assert concluded([Piece(-40, "much")]).sure == MAX_CONFIDENCE


shares = st.none() | st.floats(0, 1)


@given(
    st.lists(
        st.tuples(
            st.builds(Evidence, shares, shares, st.just(0.2), shares, shares), st.floats(0.1, 9)
        ),
        min_size=1,
    ),
    st.integers(1, 40),
)
def test_a_survey_in_pieces_tells_what_it_tells_as_one(
    parts: list[tuple[Evidence, float]], n: int
) -> None:
    whole = Evidence.merged(parts)
    pieces = [(part, area / n) for part, area in parts for _ in range(n)]
    for cut in (pieces, pieces[::-1]):
        found = Evidence.merged(cut)
        for name, value in vars(whole).items():
            assert getattr(found, name) == (None if value is None else pytest.approx(value))


def test_a_few_quiet_pieces_decide_nothing() -> None:
    flown = Evidence(several=0.3, trace=1.0, own_intensity=1.0, grey_intensity=0.0, colour=1.0)
    quiet = Evidence(several=0.0, trace=0.0, own_intensity=0.0, grey_intensity=0.0, colour=1.0)
    made = decided_by(Evidence.merged([(flown, 1.0), (quiet, 9.0)]))
    assert made is not None
    assert made.kind == LIDAR


def test_a_drone_cloud_through_which_a_bit_is_seen_is_matched_where_its_fields_say_so() -> None:
    """60 m x 60 m at 20 points/m2: a lawn, and a twelfth of it below the crowns of a loose hedge."""
    x, y = 60 * RNG.random((2, 72_000))
    crown = (x < 5) & (RNG.random(x.size) < 0.5)
    xyz = np.stack([x, y, np.where(crown, RNG.uniform(5, 6, x.size), 0.0)], axis=1)
    without = ptd.classify(xyz).decisions["statistics"]
    told = ptd.classify(xyz, evidence=Evidence.of(**DRONE)).decisions["statistics"]
    assert (without["survey"]["kind"], told["survey"]["kind"]) == (LIDAR, DIM)
    assert told["notes"][0].startswith(
        "decided: image matching (91 % sure: the points have colours; "
    )
    weak = ptd.classify(xyz, evidence=Evidence.of(rgb=RGB)).decisions["statistics"]["survey"]
    assert 0.5 < weak["sure"] < 0.9
