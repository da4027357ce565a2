"""Masks of cells: closing of small gaps, filling of holes, and places of connected cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import find_objects, label

Mask = npt.NDArray[np.bool_]
Labels = npt.NDArray[np.int32]


@dataclass(frozen=True)
class Area:
    """Connected cells: their number, and the mean column and row of their centres in the raster."""

    cells: int
    column: float
    row: float


def grown(mask: Mask, steps: int) -> Mask:
    """Return the cells within some steps of a mask, in a shape near a circle.

    Steps to the four and to the eight neighbours alternate, which makes an octagon.
    """
    for step in range(steps):
        mask = grown_once(mask, diagonally=step % 2 > 0)
    return mask


def grown_once(mask: Mask, diagonally: bool = True) -> Mask:
    """Return the cells of a mask and their eight neighbours, or only the four that share an edge."""
    wider = mask.copy()
    wider[1:] |= mask[:-1]
    wider[:-1] |= mask[1:]
    source = wider.copy() if diagonally else mask
    wider[:, 1:] |= source[:, :-1]
    wider[:, :-1] |= source[:, 1:]
    return wider


def shrunk(mask: Mask, steps: int) -> Mask:
    """Return the cells of a mask that are more than some steps from its other cells. Cells beyond the raster count."""
    return ~grown(~mask, steps)


def closed(mask: Mask, steps: int) -> Mask:
    """Return a mask with its gaps of at most two times ``steps`` cells closed."""
    padded = np.pad(mask, steps)
    inner = slice(steps, -steps)
    return shrunk(grown(padded, steps), steps)[inner, inner] | mask


def opened(mask: Mask) -> Mask:
    """Return a mask without its parts that are narrower than three cells."""
    narrower = ~grown_once(~np.pad(mask, 1))
    return grown_once(narrower)[1:-1, 1:-1]


def filled(mask: Mask) -> Mask:
    """Return a mask with its holes, which are the cells that it encloses."""
    labels, _ = label(np.pad(~mask, 1, constant_values=True))
    inside: Mask = labels[1:-1, 1:-1] != labels[0, 0]
    return inside


def areas(mask: Mask, min_cells: int) -> tuple[Labels, list[int], list[Area]]:
    """Return connected cells: labels of all, and the labels and areas of those with at least ``min_cells``.

    The largest area comes first, then the one with the lowest row and column.
    """
    labels = label(mask)[0].astype(np.int32, copy=False)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    boxes = find_objects(labels)
    found = []
    for number in np.flatnonzero(sizes >= min_cells).tolist():
        box = boxes[number - 1]
        rows, columns = np.nonzero(labels[box] == number)
        row, column = box[0].start + rows.mean(), box[1].start + columns.mean()
        found.append((number, Area(int(sizes[number]), float(column), float(row))))
    found.sort(key=lambda item: (-item[1].cells, item[1].row, item[1].column))
    return labels, [number for number, _ in found], [area for _, area in found]


def widened_boxes(labels: Labels, numbers: list[int], margin: int) -> list[tuple[slice, slice]]:
    """Return the boxes around some labels with a margin inside the raster."""
    boxes = find_objects(labels)
    found = []
    for number in numbers:
        rows, columns = (
            slice(max(side.start - margin, 0), side.stop + margin) for side in boxes[number - 1]
        )
        found.append((rows, columns))
    return found


def convex_hull(mask: Mask) -> Mask:
    """Return the cells whose centres lie in the convex hull of the centres of a mask's cells."""
    rows = np.flatnonzero(mask.any(axis=1))
    if not rows.size:
        return mask
    first = mask[rows].argmax(axis=1)
    last = mask.shape[1] - 1 - mask[rows, ::-1].argmax(axis=1)
    inside = np.arange(rows[0], rows[-1] + 1)
    left = _envelope(rows, first, inside)
    right = -_envelope(rows, -last, inside)
    columns = np.arange(mask.shape[1])
    hull = np.zeros_like(mask)
    # Rounding errors must not exclude cells on the edge.
    hull[inside] = (columns >= left[:, None] - 1e-9) & (columns <= right[:, None] + 1e-9)
    return hull


def _envelope(
    x: npt.NDArray[np.intp], y: npt.NDArray[np.intp], at: npt.NDArray[np.intp]
) -> npt.NDArray[np.float64]:
    """Return the lower convex envelope of points with ascending x at some positions (Andrew's monotone chain)."""
    chain: list[tuple[int, int]] = []
    for c in zip(x.tolist(), y.tolist(), strict=True):
        while len(chain) > 1:
            a, b = chain[-2:]
            if (b[0] - a[0]) * (c[1] - a[1]) > (c[0] - a[0]) * (b[1] - a[1]):
                break
            chain.pop()
        chain.append(c)
    corners = np.array(chain, np.float64)
    return np.interp(at, corners[:, 0], corners[:, 1])
