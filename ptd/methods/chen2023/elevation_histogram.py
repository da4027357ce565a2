"""The run's histogram of elevations, and the cut of its tails (Chen 2023, 2.1 a)."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32, lowest_per_cell
from ptd.frame import CellLattice, Scale, Window
from ptd.passes import Partial, Pass, Points, State, StatisticsModel, add_notes

BIN_M = 1.0
Bool = npt.NDArray[np.bool_]

Histogram = dict[int, int]
"""Number of points per bin; bin k holds heights from k to below k + 1 metres."""


class Tails(NamedTuple):
    """The range of heights that is kept, and the numbers of points below and above it."""

    low_bin: int
    high_bin: int
    below: int
    above: int


def _bins(z: Int32, scale: Scale) -> npt.NDArray[np.int64]:
    """Return the bin of each height. Bin 0 starts at height 0 of the CRS."""
    bins: npt.NDArray[np.int64] = np.floor(z / scale.counts_z(BIN_M)).astype(np.int64)
    return bins


def histogram(z: Int32, scale: Scale) -> Histogram:
    """Number of heights in each bin that holds any."""
    bins, counts = np.unique(_bins(z, scale), return_counts=True)
    return dict(zip(bins.tolist(), counts.tolist(), strict=True))


def merged(parts: Iterable[Mapping[int, int]]) -> Histogram:
    """The histogram of all parts together. Sums of integers do not depend on their order."""
    total: Counter[int] = Counter()
    for part in parts:
        total.update(part)
    return dict(sorted(total.items()))


def find_tails(counts: Histogram, gap_bins: int, share: float) -> Tails | None:
    """Cut both tails of a histogram at gaps.

    The paper chooses from a plot of the histogram. Here a tail is the part beyond at least
    ``gap_bins`` empty bins, if it has at most ``share`` of all points. Terrain fills its
    elevations without gaps, so a lonely peak stays, however few points it has. A second survey
    area far above the first stays because of its share.

    Returns
    -------
    Tails or None
        None for an empty histogram.
    """
    if not counts:
        return None
    bins = sorted(counts)
    room = share * sum(counts.values())
    low, below = _inner_end(bins, counts, gap_bins, room)
    high, above = _inner_end(bins[::-1], counts, gap_bins, room)
    return Tails(low, high, below, above)


def _inner_end(bins: list[int], counts: Histogram, gap: int, room: float) -> tuple[int, int]:
    """The first bin after the last gap with at most `room` points before it, and the number of these points."""
    end, cut, seen = bins[0], 0, 0
    for before, after in pairwise(bins):
        seen += counts[before]
        if seen > room:
            break
        if abs(after - before) > gap:
            end, cut = after, seen
    return end, cut


def outside(z: Int32, scale: Scale, kept: list[int] | None) -> tuple[Bool, Bool]:
    """Return masks of the heights below and above the kept range. Both are false if there is no range."""
    if kept is None:
        return np.zeros(z.size, np.bool_), np.zeros(z.size, np.bool_)
    bins = _bins(z, scale)
    return bins < kept[0], bins > kept[1]


@dataclass(frozen=True)
class ElevationsPass(Pass):
    """Measure the run's histogram. The state gets ``tails``: the lowest and highest bin kept, or None.

    Attributes
    ----------
    cell_m : float
        Size of the cells of candidates.
    gap_m, share : float
        See `find_tails`; a gap of 0 finds no tails.
    """

    cell_m: float
    gap_m: float
    share: float
    name: str = "elevations"
    title = "measure the range of heights"
    gives_labels: bool = False

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> StatisticsModel:
        """Count the candidates of the core. Bins and counts are pairs, because names in JSON are texts."""
        x, y, z = points.columns()
        keep = lowest_per_cell(x, y, z, CellLattice.of(self.cell_m, scale))
        keep = keep[core.contains(x[keep], y[keep])]
        return StatisticsModel(
            {"elevations": sorted(histogram(z[keep], scale).items())}, {"candidates": keep.size}
        )

    def reduce(self, partials: Iterable[Partial], state: State) -> State:
        """Merge the counts, find the tails, and report the cut."""
        counts = merged({int(k): int(n) for k, n in part["elevations"]} for part in partials)
        tails = None
        if self.gap_m:
            tails = find_tails(counts, math.ceil(self.gap_m / BIN_M), self.share)
        if tails is None:
            return {**state, "tails": None}
        cut = (tails.below, "below", tails.low_bin), (tails.above, "above", tails.high_bin + 1)
        notes = (
            f"{n} candidates {side} {level * BIN_M:g} m are outliers: beyond a gap of {self.gap_m:g} m "
            f"in the run's elevations, and no more than {self.share:g} of all"
            for n, side, level in cut
            if n
        )
        return {
            **state,
            "tails": [tails.low_bin, tails.high_bin],
            "notes": add_notes(state, *notes),
        }
