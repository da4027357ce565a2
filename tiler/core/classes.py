"""ASPRS classes: which points take part in a filter, and which classes a filter may write."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import cache

import numpy as np
import numpy.typing as npt

from tiler.core.reclass import ONLY_GROUND

UNCLASSIFIED = 1
GROUND = 2
LOW_NOISE = 7
WATER = 9
BRIDGE = 17
HIGH_NOISE = 18

NOISE = (LOW_NOISE, HIGH_NOISE)

# Bits of `PointBlock.flags`, the same for every point format.
WITHHELD_FLAG = 1
SYNTHETIC_FLAG = 2
OVERLAP_FLAG = 4
KEY_POINT_FLAG = 8
STRAY_FLAG = 16
"""Set by ingest (`tiler.ingest.strays`) on points that belong to nothing; the first four flags come from the source."""
UNSELECTED_FLAG = 32
"""Set by ingest on points that the settings of the run do not select (`tiler.core.selection`)."""

UNSEEN_FLAGS = WITHHELD_FLAG | STRAY_FLAG | UNSELECTED_FLAG
"""Flags of points that no run sees, whatever its other settings."""

MARK_BIT = 0x80
"""Bit of a label: data outside the filter's window could change the decision."""
WATER_BIT = 0x40
"""Bit of a label: the point lies in a body of water."""

WITHOUT_OBJECT = (0, UNCLASSIFIED, GROUND)
"""Classes of a producer that name no kind of object. Class 0 is "never classified"."""

Counts = Mapping[str, int]
"""Class, as JSON has it, to points."""


def participates(
    classification: npt.NDArray[np.uint8],
    flags: npt.NDArray[np.uint8],
    keep_classes: Sequence[int] = (LOW_NOISE, WATER, BRIDGE, HIGH_NOISE),
    skip_flags: int = WITHHELD_FLAG,
) -> npt.NDArray[np.bool_]:
    """Mask of the points that take part in filtering.

    Parameters
    ----------
    classification, flags : uint8, shape (n,)
    keep_classes : sequence of int
        Classes that never take part and are never overwritten.
    skip_flags : int
        Bits of `flags` that keep a point out; withheld points always stay out.
    """
    kept = np.zeros(256, dtype=np.bool_)
    kept[list(keep_classes)] = True
    taking: npt.NDArray[np.bool_] = ~kept[classification] & ((flags & (skip_flags | WITHHELD_FLAG)) == 0)
    return taking


@cache
def written_classes(reclass: str) -> npt.NDArray[np.uint8]:
    """Table of the classes in a classified cloud.

    Parameters
    ----------
    reclass : str
        With `tiler.core.reclass.ALL`, a point gets the class of its label. With `ONLY_GROUND`, a point that is neither
        ground nor low noise keeps the class of its producer, except for `WITHOUT_OBJECT`; in water, former ground
        becomes water.

    Returns
    -------
    uint8, shape (256, 256)
        The new class by label (first axis) and class of the producer (second axis). A label has no `MARK_BIT`, but has
        `WATER_BIT` in water. The label 0 keeps the class.
    """
    given = np.arange(256, dtype=np.uint8)
    plain = np.isin(given, WITHOUT_OBJECT)
    found = np.tile(given, (256, 1))
    for label in (UNCLASSIFIED, GROUND, LOW_NOISE, BRIDGE):
        found[[label, label | WATER_BIT]] = label
    if reclass == ONLY_GROUND:
        found[UNCLASSIFIED] = np.where(plain, UNCLASSIFIED, given)
        found[UNCLASSIFIED | WATER_BIT] = np.where(plain, WATER, given)
        found[GROUND | WATER_BIT] = WATER
    found.flags.writeable = False
    return found


def sum_by_class(counts: Iterable[Counts]) -> dict[str, int]:
    """The sum of counts by class, in the order of the classes."""
    total: Counter[str] = Counter()
    for found in counts:
        total.update(found)
    return {code: total[code] for code in sorted(total, key=int)}
