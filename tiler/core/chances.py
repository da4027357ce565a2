"""Chances that places to review are wrong, and the order of such places.

The chances are frequencies on scenes whose terrain is known. `tests/benchmarks/places.py` measures them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

LIDAR, PHOTOGRAMMETRIC = "lidar", "dim"
"""Kinds of clouds, by their names in run.json."""


@dataclass(frozen=True)
class Reason:
    """Reason to review a place.

    Attributes
    ----------
    error_m : float or None
        Typical height error of the wrong places in metres, for the order of places without a height at stake. None if
        it is unknown.
    measured : mapping of str to (int, int)
        Number of places on scenes whose terrain is known, and of the wrong ones, by kind of cloud.
    is_certain : bool
        Whether the result is wrong by definition, such as a hole in the survey. It has no chance.
    """

    error_m: float | None = None
    measured: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    is_certain: bool = False


HOLE_M = 1.0
"""Height error that a missing height counts as in the order of places."""

REASONS: dict[str, Reason] = {
    "failed task": Reason(HOLE_M, is_certain=True),
    "terrain below all returns": Reason(HOLE_M, is_certain=True),
    "void inside the survey": Reason(HOLE_M, is_certain=True),
    # Most of them are the ragged border of the survey, which nobody changes.
    "void at the border of the survey": Reason(),
    "terrain above all returns": Reason(),
    # The finder gives a chance for each place.
    "object left in the terrain": Reason(),
    "objects suspected in the terrain": Reason(),
    "place without returns": Reason(),
    "doubtful water": Reason(),
    "ground hidden by canopy": Reason(),
    "doubtful tile": Reason(),
    # They report what an edit or the input did, not a doubt about the terrain.
    "hole in an edit": Reason(),
    "edit without effect": Reason(),
    "stray point": Reason(),
}
"""All reasons whose places have a position."""

LEAST_PLACES = 10
"""Least number of places with a known terrain from which a chance is measured."""


def chance_of(reason: str, kind: str | None) -> float | None:
    """Return the chance that a place is wrong, or None if too few places with a known terrain tell it.

    ``kind`` is the kind of the cloud, or None if the run did not decide it.
    """
    return chance_from(*REASONS.get(reason, Reason()).measured.get(kind or "", (0, 0)))


def chance_from(places: int, wrong: int) -> float | None:
    """Return the chance with two decimals after so many places and wrong ones, or None if they are too few.

    It is the mean of the shares that the counts leave possible if all were equally likely before (Beta(1, 1)), so that
    few places give no certainty.
    """
    return round((wrong + 1) / (places + 2), 2) if places >= LEAST_PLACES else None


def expected_loss(
    reason: str, chance: float | None, stake_m: float | None, area_m2: float
) -> float | None:
    """Return the squared height error that is expected in a place, in m2 times m2, or None if it is not known.

    It is the chance times the square of the height at stake times the area. A result that is wrong by definition has
    the chance 1. The height at stake, if it is not known, is the typical error of the reason.
    """
    known = REASONS.get(reason, Reason())
    chance = 1.0 if known.is_certain else chance
    stake_m = known.error_m if stake_m is None else stake_m
    return None if chance is None or stake_m is None else chance * stake_m**2 * area_m2
