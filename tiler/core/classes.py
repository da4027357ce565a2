"""ASPRS classes that decide what takes part in a filter and what a filter may write."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

UNCLASSIFIED = 1
GROUND = 2
LOW_NOISE = 7
WATER = 9
BRIDGE = 17
HIGH_NOISE = 18

NOISE = (LOW_NOISE, HIGH_NOISE)

WITHHELD_FLAG = 1
SYNTHETIC_FLAG = 2
OVERLAP_FLAG = 4
KEY_POINT_FLAG = 8
STRAY_FLAG = 16
"""Bits of `PointBlock.flags`, the same for every point format; strays are found by ingest."""

MARK_BIT = 0x80
"""Bit of a label: the decision rests on something that data outside the filter's window could change."""


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
