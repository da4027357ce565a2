"""Two thresholds of a run from its histograms: the greenness of vegetation, and the first distance of ground.

Sources: Dong 2017 (004), equation 2, sections 3.3.1 and 3.3.3; Otsu (1979), A threshold
selection method from gray-level histograms. Greenness is arithmetic on whole numbers, so order,
tiles and the range of the colours (8 or 16 bits) change nothing. For the distance the paper
only shows a picture; `second_difference_jump` explains how it is read here.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from ptd.arrays import Int16, UInt16
from ptd.kernel import kernel

BINS = 128
"""Number of bins of the histogram of the index, which ranges from -1 to 1."""

GREY = BINS // 2
"""The bin that begins at grey. Greener colours are in it and above."""

COLOURLESS = -1
"""Bin of black points. A source without colours has only such points."""

SMOOTHINGS = 2
"""Number of smoothings of the counts by (1, 4, 6, 4, 1).

Dark 8-bit colours have few ratios, and the gaps between these must not look like valleys.
"""

VALLEY_SHARE = 0.8
"""Largest height of a valley between two modes, as a share of the lower mode."""

MODE_SHARE = 0.01
"""Least share of the points in a mode."""


@kernel
def _bins(rgb: UInt16, out: Int16) -> None:
    for i in range(out.size):
        red, green, blue = np.int64(rgb[0, i]), np.int64(rgb[1, i]), np.int64(rgb[2, i])
        total = 2 * green + red + blue
        out[i] = -1 if total == 0 else min(int((2 * green * BINS) // total), BINS - 1)


def gli_bins(rgb: UInt16) -> Int16:
    """Bin of the green leaf index ``(2G - R - B) / (2G + R + B)`` of each point (004, equation 2).

    ``(GLI + 1) / 2 = 2G / (2G + R + B)``, so a bin is one division of whole numbers.

    Parameters
    ----------
    rgb : uint16 [3, n]
        Red, green, blue of any range.

    Returns
    -------
    int16 [n]
        0 .. `BINS` - 1, `COLOURLESS` for black.
    """
    out = np.empty(rgb.shape[1], np.int16)
    _bins(np.ascontiguousarray(rgb), out)
    return out


def index_of_bin(first: int) -> float:
    """The green leaf index at which a bin begins."""
    return 2.0 * first / BINS - 1.0


def smoothed(counts: Sequence[int]) -> list[int]:
    """Counts smoothed `SMOOTHINGS` times, in units of 1/16 each time."""
    values = np.array(counts, np.int64)
    for _ in range(SMOOTHINGS):
        values = np.convolve(values, (1, 4, 6, 4, 1), "same")
    return [int(v) for v in values]


def two_modes(counts: Sequence[int]) -> tuple[int, int] | None:
    """Bins of a grey and a green mode beside each other, or None.

    The check is needed because Otsu's threshold splits any histogram, even one with a single
    mode.

    The highest smoothed counts to the left and right of a bin are compared with its own count.
    The valley is the bin whose count lies farthest below the lower one. Only colours greener
    than grey count; otherwise red roofs beside grey streets would make the streets green.

    Parameters
    ----------
    counts : sequence of int
        Points by bin of `gli_bins`.
    """
    values, total = smoothed(counts), sum(counts)
    best, valley = 0, -1
    for k in range(GREY, len(values) - 1):
        depth = min(max(values[:k]), max(values[k + 1 :])) - values[k]
        if depth > best:
            best, valley = depth, k
    if valley < 0 or values[valley] > VALLEY_SHARE * (values[valley] + best):
        return None
    left, right = sum(counts[:valley]), sum(counts[valley:])
    if min(left, right) < MODE_SHARE * total:
        return None
    return _nearest_mode(values, valley, -1), _nearest_mode(values, valley, 1)


def _nearest_mode(values: Sequence[int], valley: int, step: int) -> int:
    """The top of the nearest mode on one side of a valley.

    The mode ends where the counts fall below `VALLEY_SHARE` of its top.
    """
    top = k = valley
    while 0 <= k < len(values) and values[k] >= VALLEY_SHARE * values[top]:
        if values[k] > values[top]:
            top = k
        k += step
    return top


def otsu(counts: Sequence[int]) -> int:
    """The first bin of the upper class of Otsu's two classes.

    The split maximises the variance between the classes; among equal splits the lowest is
    taken.

    Parameters
    ----------
    counts : sequence of int
        Points by bin; at least two bins hold points.
    """
    n, moment = sum(counts), sum(k * c for k, c in enumerate(counts))
    below, moment_below, best, split = 0, 0, Fraction(-1), 1
    for k, count in enumerate(counts):
        below += count
        moment_below += k * count
        if not 0 < below < n:
            continue
        between = Fraction((n * moment_below - below * moment) ** 2, below * (n - below))
        if between > best:
            best, split = between, k + 1
    return split


def green_from(counts: Sequence[int]) -> int | None:
    """Return the first bin that is vegetation, at least `GREY`, or None if the histogram has no separate green mode.

    It is Otsu's threshold of the part between the grey and the green mode, so a third mode (red
    roofs) has no effect.
    """
    modes = two_modes(counts)
    if modes is None:
        return None
    low, high = modes
    return max(low + otsu(counts[low : high + 1]), GREY)


SETTLED_SHARE = 0.05
"""Share of the steepest fall. The counts have settled where they fall by less."""


def second_difference_jump(counts: Sequence[int]) -> int | None:
    """Number of bins of the first population of a histogram, by the second difference of its accumulated counts.

    Distances of ground to the seeds' TIN are small. On facades the distance "will sharply
    become big" (3.3.3), and the accumulated histogram bends from a steep climb to a slow one.
    Its second difference is the change of the counts from bin to bin. It jumps down where the
    ground thins out, and returns to about zero where the ground ends, which is the threshold.
    For normal noise it jumps at one sigma, and returns to a twentieth of its depth at three
    sigma.

    Parameters
    ----------
    counts : sequence of int
        Counts by bin, from near to far.

    Returns
    -------
    int or None
        None if the counts never fall.
    """
    change = np.diff(np.asarray(counts, np.int64))
    if change.size == 0 or change.min() >= 0:
        return None
    steepest = int(np.argmin(change))
    settled = np.flatnonzero(-change[steepest:] <= SETTLED_SHARE * -change[steepest])
    if not settled.size:
        return len(counts)
    return steepest + int(settled[0]) + 1
