"""Cells of the first returns of a survey, without strays: a few first returns far from all others, as in a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from tiler.apps.acceptance.counts import Cells, FileCounts, Int64s, Keys, Mask, decoded, merged
from tiler.core.lattice import COUNTS_PER_UNIT, Cell, Lattice
from tiler.core.words import counted, listed
from tiler.ingest.strays import far_buckets
from tiler.inputs import FAR
from tiler.inputs.extent import can_be_strays

MAX_NAMED = 5
"""Number of places and of files that the note names."""


@dataclass(frozen=True)
class Survey:
    """Cells of the first returns of all files that are not strays.

    Attributes
    ----------
    keys, counts : uint64 and int64, shape (n,)
        Keys of `Cells`, sorted, and number of first returns in each.
    note : str
        Note about strays, or about clouds that lie far apart. Empty without them.
    is_apart : bool
        Whether more first returns than strays are farther away than cells reach. The cells do not have them.
    """

    keys: Keys
    counts: Int64s
    note: str = ""
    is_apart: bool = False


def survey_of(files: Sequence[FileCounts], cells: Cells) -> Survey:
    """Return the cells of the first returns of all files, without strays."""
    keys, counts = merged((file.keys, file.counts) for file in files)
    total = sum(file.first_returns for file in files)
    n_beyond = total - int(counts.sum())
    if n_beyond and not can_be_strays(n_beyond, total):
        return Survey(keys, counts, _far_apart(files, n_beyond), is_apart=True)
    strays = _strays(keys, counts, cells)
    n_strays = int(counts[strays].sum()) + n_beyond
    if not n_strays:
        return Survey(keys, counts)
    _, columns, rows = decoded(keys[strays])
    x = (columns + cells.column + 0.5) * cells.side
    y = (rows + cells.row + 0.5) * cells.side
    places = [f"around {a:.1f} {b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True)]
    places += ["farther than cells reach"] if n_beyond else []
    names = [
        str(file.path)
        for file in files
        if _reaches_beyond(file) or np.isin(keys[strays], file.keys).any()
    ]
    note = (
        f"{listed(names, MAX_NAMED, 'files')}: {counted(n_strays, 'first return')} far from all others left out of "
        f"the rows of cells, {listed(places, MAX_NAMED, 'places')}"
    )
    return Survey(keys[~strays], counts[~strays], note)


def _far_apart(files: Sequence[FileCounts], n_beyond: int) -> str:
    names = [str(file.path) for file in files if _reaches_beyond(file)]
    return (
        f"{listed(names, MAX_NAMED, 'files')}: the clouds lie farther apart than cells reach, and no cell has "
        f"{counted(n_beyond, 'first return')} of these files; check only clouds that lie together, or withhold points "
        "far from all others"
    )


def _reaches_beyond(file: FileCounts) -> bool:
    return file.first_returns > int(file.counts.sum())


def _strays(keys: Keys, counts: Int64s, cells: Cells) -> Mask:
    """Return the mask of the cells in which all first returns are strays."""
    _, columns, rows = decoded(keys)
    side = max(FAR, cells.side)
    x, y = (
        np.floor((of_cells + first + 0.5) * (cells.side / side)).astype(np.int64)
        for of_cells, first in ((columns, cells.column), (rows, cells.row))
    )
    strays = np.zeros(keys.size, np.bool_)
    if not keys.size or max(np.ptp(x), np.ptp(y)) < 2:
        return strays
    width = int(np.ptp(x)) + 1
    bucket = (y - y.min()) * width + x - x.min()
    # Cells of a row follow each other, so few of them remain to be sorted.
    starts = np.flatnonzero(np.r_[True, bucket[1:] != bucket[:-1]])
    found, inverse = np.unique(bucket[starts], return_inverse=True)
    numbers = np.bincount(inverse, np.add.reduceat(counts, starts)).astype(np.int64)
    buckets = {
        Cell(number % width, number // width): n
        for number, n in zip(found.tolist(), numbers.tolist(), strict=True)
    }
    far = far_buckets(buckets, Lattice(Fraction(side) * COUNTS_PER_UNIT))
    if far:
        strays = np.isin(bucket, [cell.iy * width + cell.ix for cell in far])
    return strays
