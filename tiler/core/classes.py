"""ASPRS classes: the points that take part in a filter, and the classes that a filter may write."""

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

# The bits of `PointBlock.flags` are the same for every point format. The first four flags come
# from the source.
WITHHELD_FLAG = 1
SYNTHETIC_FLAG = 2
OVERLAP_FLAG = 4
KEY_POINT_FLAG = 8
STRAY_FLAG = 16
"""Flag that ingest (`tiler.ingest.strays`) sets on stray points."""
UNSELECTED_FLAG = 32
"""Flag that ingest sets on points that the settings of the run do not select
(`tiler.core.selection`)."""
REPEATED_FLAG = 64
"""Flag that ingest (`tiler.ingest.assemble`) sets on points at the position of another point,
which represents them. A run sees only that point, and they get its label."""

UNSEEN_FLAGS = WITHHELD_FLAG | STRAY_FLAG | UNSELECTED_FLAG | REPEATED_FLAG
"""Flags of points that a run ignores, independent of its other settings."""

LABELS = "labels"
"""Name in the store of the labels that a run ends with."""
LABELS = "labels"
"""Name in the store of the labels that a run ends with."""
UNCERTIFIED_BIT = 0x80
"""Bit of a label that data outside the filter's window could change."""
WATER_BIT = 0x40
"""Bit of the label of a point in a body of water."""

WITHOUT_OBJECT = (0, UNCLASSIFIED, GROUND)
"""Classes of a producer that do not name a kind of object. Class 0 is "never classified"."""

Counts = Mapping[str, int]
"""Number of points by class, which is a string as in JSON."""


def participates(
    classification: npt.NDArray[np.uint8],
    flags: npt.NDArray[np.uint8],
    keep_classes: Sequence[int] = (LOW_NOISE, WATER, BRIDGE, HIGH_NOISE),
    skip_flags: int = WITHHELD_FLAG,
) -> npt.NDArray[np.bool_]:
    """Return the mask of the points that take part in filtering.

    Parameters
    ----------
    classification, flags : uint8, shape (n,)
    keep_classes : sequence of int
        Classes that never take part and are never overwritten.
    skip_flags : int
        Bits of ``flags`` that exclude a point. Withheld points are always excluded.
    """
    kept = np.zeros(256, dtype=np.bool_)
    kept[list(keep_classes)] = True
    taking: npt.NDArray[np.bool_] = ~kept[classification] & (
        (flags & (skip_flags | WITHHELD_FLAG)) == 0
    )
    return taking


@cache
def written_classes(reclass: str) -> npt.NDArray[np.uint8]:
    """Return the table of the classes in a classified cloud.

    Parameters
    ----------
    reclass : str
        With `tiler.core.reclass.ALL`, a point gets the class of its label. With `ONLY_GROUND`, ground in water becomes
        `WATER`, and a point with the label `UNCLASSIFIED` keeps the class of its producer. If that class is in
        `WITHOUT_OBJECT`, the point becomes `UNCLASSIFIED`, or `WATER` in water.

    Returns
    -------
    uint8, shape (256, 256)
        New class by label (first axis) and class of the producer (second axis). Labels are without `UNCERTIFIED_BIT`,
        but with `WATER_BIT` in water. The label 0 keeps the class.
    """
    given = np.arange(256, dtype=np.uint8)
    plain = np.isin(given, WITHOUT_OBJECT)
    table = np.tile(given, (256, 1))
    for label in (UNCLASSIFIED, GROUND, LOW_NOISE, BRIDGE):
        table[[label, label | WATER_BIT]] = label
    if reclass == ONLY_GROUND:
        table[UNCLASSIFIED] = np.where(plain, UNCLASSIFIED, given)
        table[UNCLASSIFIED | WATER_BIT] = np.where(plain, WATER, given)
        table[GROUND | WATER_BIT] = WATER
    table.flags.writeable = False
    return table


def sum_by_class(counts: Iterable[Counts]) -> dict[str, int]:
    """Return the sum of counts by class, in the order of the classes."""
    total: Counter[str] = Counter()
    for class_counts in counts:
        total.update(class_counts)
    return {code: total[code] for code in sorted(total, key=int)}
