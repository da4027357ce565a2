"""Cells near set cells, and distances from set cells in strips, as a distance transform takes 50 bytes per cell."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import scipy

Bools = npt.NDArray[np.bool_]
Float64 = npt.NDArray[np.float64]

STRIP_ROWS = 256
"""Rows per strip, or twice the radius if that is more."""


def within(cells: Bools, radius: float) -> Bools:
    """Return a mask of the cells within a radius of a set cell, measured between centres in cells.

    The cells are spread sideways step by step, and shifted up and down from the most distant
    row of a disk to its middle, where the disk is widest. For usual radii this takes a tenth of
    the time of a distance transform.
    """
    near_mask = np.zeros(cells.shape, np.bool_)
    box = box_around(cells, max(math.floor(radius), 0))
    source, near = cells[box], near_mask[box]
    spread = source.copy()
    width = 0
    for rows in range(min(math.floor(radius), len(source)), -1, -1):
        while width < source.shape[1] and math.sqrt((width + 1) ** 2 + rows**2) <= radius:
            width += 1
            spread[:, width:] |= source[:, :-width]
            spread[:, :-width] |= source[:, width:]
        near[rows:] |= spread[: len(spread) - rows]
        near[: len(near) - rows] |= spread[rows:]
    return near_mask


def opened(cells: Bools, radius: float) -> Bools:
    """Return a mask without the parts in which no disk of this radius fits. Cells beyond the border are not set."""
    pad = math.floor(radius)
    padded = np.pad(~cells, pad, constant_values=True)
    eroded = ~within(padded, radius)[pad : pad + len(cells), pad : pad + cells.shape[1]]
    return within(eroded, radius)


def within_square(cells: Bools, radius: int) -> Bools:
    """Return a mask of the cells with a set cell within ``radius`` rows and columns."""
    near = cells.copy()
    for step in range(1, radius + 1):
        near[step:] |= cells[:-step]
        near[:-step] |= cells[step:]
    rows = near.copy()
    for step in range(1, radius + 1):
        near[:, step:] |= rows[:, :-step]
        near[:, :-step] |= rows[:, step:]
    return near


def distances(cells: Bools, radius: float) -> Float64:
    """Return the distance of each cell from the nearest set cell, in cells, infinite beyond a radius."""
    near_distances = np.full(cells.shape, np.inf)
    for part, distance in _strips(cells, radius):
        np.copyto(near_distances[part], distance, where=distance <= radius)
    return near_distances


def box_around(cells: Bools, pad: int) -> tuple[slice, slice]:
    """Return the rows and columns of the box around the set cells, padded by ``pad`` cells within the array."""
    slices = []
    for axis in (1, 0):
        lines = np.flatnonzero(cells.any(axis=axis))
        first, last = (int(lines[0]), int(lines[-1])) if len(lines) else (0, -1)
        slices.append(slice(max(first - pad, 0), last + 1 + pad))
    return slices[0], slices[1]


def _strips(cells: Bools, radius: float) -> Iterator[tuple[tuple[slice, slice], Float64]]:
    """Yield the parts with set cells near them, and their distances, which are correct up to the radius."""
    margin = max(math.floor(radius), 0)
    step = max(STRIP_ROWS, 2 * margin)
    rows, cols = box_around(cells, margin)
    for first in range(rows.start, min(rows.stop, len(cells)), step):
        top, end = max(first - margin, 0), min(first + step, rows.stop)
        strip = cells[top : end + margin, cols]
        if strip.any():
            distance = scipy.ndimage.distance_transform_edt(~strip)[first - top :][
                : end - first
            ]
            yield (slice(first, first + len(distance)), cols), distance
