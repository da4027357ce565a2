"""Chances that places to review are wrong, and the order of such places.

The chances are frequencies on scenes whose terrain is known. `tests/benchmarks/places.py` measures them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

LIDAR, PHOTOGRAMMETRIC = "lidar", "dim"
"""Kinds of clouds, by their names in run.json."""


class Counts(NamedTuple):
    """Number of places on scenes whose terrain is known, and of the wrong ones."""

    places: int
    wrong: int


@dataclass(frozen=True)
class Reason:
    """Reason to review a place.

    Attributes
    ----------
    error_m : float or None
        Typical height error of the wrong places in metres, for the order of places without a height at stake. None if
        it is unknown.
    measured : mapping of str to sequence of Counts
        Counts by kind of cloud: of all places, or of those below and those from ``large_m2``.
    large_m2 : float or None
        Area from which places are counted apart.
    is_certain : bool
        Whether the result is wrong by definition, such as a hole in the survey. It has no chance.
    """

    error_m: float | None = None
    measured: Mapping[str, Sequence[Counts]] = field(default_factory=dict)
    large_m2: float | None = None
    is_certain: bool = False

    def size(self, area_m2: float | None) -> int:
        """Return the index of the counts of places of this area."""
        return int(self.large_m2 is not None and (area_m2 or 0.0) >= self.large_m2)


LEFT = "object left in the terrain"
"""Reason whose places have their own chances."""
UNSURE = "unsure terrain"
"""The same, for places with few ground points."""
HOLE_M = 1.0
"""Height error that a missing height counts as in the order of places."""

REASONS: dict[str, Reason] = {
    "failed task": Reason(HOLE_M, is_certain=True),
    "file left out": Reason(HOLE_M, is_certain=True),
    "terrain below all returns": Reason(HOLE_M, is_certain=True),
    "void inside the survey": Reason(HOLE_M, is_certain=True),
    # Most of them are the ragged border of the survey, which nobody changes, so they have no loss and come late.
    "void at the border of the survey": Reason(is_certain=True),
    "terrain above all returns": Reason(3.1, is_certain=True),
    # The finder gives a chance for each place.
    LEFT: Reason(),
    UNSURE: Reason(),
    "objects suspected in the terrain": Reason(10.1, {LIDAR: [Counts(1, 1)]}),
    "place without returns": Reason(
        1.2,
        {
            LIDAR: [Counts(25, 3), Counts(53, 13)],
            PHOTOGRAMMETRIC: [Counts(16, 4), Counts(20, 14)],
        },
        large_m2=200.0,
    ),
    "doubtful water": Reason(0.7, {LIDAR: [Counts(5, 1)]}),
    "ground hidden by canopy": Reason(2.1, {PHOTOGRAMMETRIC: [Counts(18, 18)]}),
    "doubtful tile": Reason(),
    # They report what an edit or the input did, which is no doubt about the terrain.
    "hole in an edit": Reason(is_certain=True),
    "edit without effect": Reason(),
    "stray point": Reason(),
}
"""All reasons whose places have a position. The counts are of 63 scenes, simulated and real."""

UNKNOWN = 0.5
"""Chance that a place counts with in the order if its chance is not known."""
LEAST_PLACES = 10
"""Least number of places with a known terrain from which a chance is measured."""
SHRINK = 4
"""The mean of all sizes counts like so many places in the chance of a size, so that few places give no certainty."""


def chance_of(reason: str, kind: str | None, area_m2: float | None = None) -> float | None:
    """Return the chance that a place is wrong, or None if too few places with a known terrain tell it.

    ``kind`` is the kind of the cloud, or None if the run did not decide it.
    """
    known = REASONS.get(reason, Reason())
    return chance_from(known.measured.get(kind or "", ()), known.size(area_m2))


def chance_from(sizes: Sequence[Counts], size: int) -> float | None:
    """Return the chance of places of a size with two decimals, or None if the places of all sizes are too few.

    The chance of all sizes is the mean of the shares that the counts leave possible if all shares were equally likely
    before (Beta(1, 1)).
    """
    places, wrong = (sum(counts[i] for counts in sizes) for i in (0, 1))
    if places < LEAST_PLACES:
        return None
    mean = (wrong + 1) / (places + 2)
    if len(sizes) == 1:
        return round(mean, 2)
    of_size = sizes[size]
    return round((of_size.wrong + SHRINK * mean) / (of_size.places + SHRINK), 2)


def expected_loss(
    reason: str, chance: float | None, stake_m: float | None, area_m2: float
) -> float | None:
    """Return the squared height error that is expected in a place, in m2 times m2, or None if it is not known.

    It is the chance times the square of the height at stake times the area. A result that is wrong by definition has
    the chance 1, and a chance that is not known counts as `UNKNOWN`. The height at stake, if it is not known, is the
    typical error of the reason.
    """
    known = REASONS.get(reason, Reason())
    chance = 1.0 if known.is_certain else UNKNOWN if chance is None else chance
    stake_m = known.error_m if stake_m is None else stake_m
    return None if stake_m is None else chance * stake_m**2 * area_m2
