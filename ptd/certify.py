"""Doubt: where points outside the window could change something, and which triangles that reaches.

A triangle is the same for any larger cloud if its circumcircle holds no place in doubt. A decision that used a triangle
in doubt puts its point's place in doubt too, since the point may or may not become a vertex. So doubt grows round by
round from the closed sides of the window, and what it has not reached is proven equal to the untiled run.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ptd.frame import OPEN, Scale, Window
from ptd.kernel import kernel
from ptd.tin.layout import Int32Array, is_ghost

DOUBT_CELL_M = 2.0
MAX_RASTER = 1024
"""Cells of the raster of doubt along its longer side, at most."""

Float32 = npt.NDArray[np.float32]
UInt8 = npt.NDArray[np.uint8]


@kernel
def _mark_places(
    mask: UInt8, west: int, south: int, cell: int, x: Int32Array, y: Int32Array, which: npt.NDArray[np.bool_]
) -> bool:
    """Put the places of the chosen points in doubt; whether that was new for any of them."""
    changed = False
    for i in range(x.size):
        if which[i]:
            column = min(max((x[i] - west) // cell, 0), mask.shape[1] - 1)
            row = min(max((y[i] - south) // cell, 0), mask.shape[0] - 1)
            if mask[row, column] == 0:
                mask[row, column] = 1
                changed = True
    return changed


@kernel
def _circle_in_doubt(
    bx: float,
    by: float,
    cx: float,
    cy: float,
    ax: float,
    ay: float,
    west: float,
    south: float,
    cell: float,
    free: Float32,
) -> bool:
    """Whether the circle through a, a + b, a + c may hold a place in doubt (rarely a wrong yes, never a wrong no)."""
    area = 2.0 * (bx * cy - by * cx)
    b2, c2 = bx * bx + by * by, cx * cx + cy * cy
    if abs(area) <= 1e-9 * (abs(bx * cy) + abs(by * cx)):
        return True
    ux, uy = (cy * b2 - by * c2) / area, (bx * c2 - cx * b2) / area
    radius = math.sqrt(ux * ux + uy * uy) * (1.0 + 1e-6) + 1.0
    x, y = (ax + ux - west) / cell, (ay + uy - south) / cell
    near_x = min(max(x, 0.0), free.shape[1] - 1.0)
    near_y = min(max(y, 0.0), free.shape[0] - 1.0)
    # The nearest point of the raster is nearer to all of it than the centre is, by at least the rest of a right angle.
    beyond2 = (x - near_x) ** 2 + (y - near_y) ** 2
    clear = float(free[int(near_y), int(near_x)])
    return radius >= math.sqrt(beyond2 + clear * clear) * cell


@kernel
def _doubtful_triangles(
    vertices: Int32Array,
    triangles: Int32Array,
    n: int,
    west: int,
    south: int,
    cell: int,
    free: Float32,
    out: UInt8,
) -> None:
    for t in range(n):
        if is_ghost(triangles, t):
            out[t] = 1
            continue
        a, b, c = triangles[8 * t + 4], triangles[8 * t + 5], triangles[8 * t + 6]
        ax, ay = vertices[4 * a], vertices[4 * a + 1]
        out[t] = _circle_in_doubt(
            float(vertices[4 * b] - ax), float(vertices[4 * b + 1] - ay),
            float(vertices[4 * c] - ax), float(vertices[4 * c + 1] - ay),
            float(ax), float(ay), float(west), float(south), float(cell), free,
        )  # fmt: skip


class Doubt:
    """Raster of places in doubt around and inside a window.

    Parameters
    ----------
    window : Window
    box : (int, int, int, int)
        West, south, east, north of the vertices that there will be, local counts.
    scale : Scale
    """

    def __init__(self, window: Window, box: tuple[int, int, int, int], scale: Scale) -> None:
        self.active = window.closed
        span = max(box[2] - box[0], box[3] - box[1], 1)
        self.cell = max(int(scale.counts(DOUBT_CELL_M)), -(-span // MAX_RASTER)) if self.active else span
        self.west, self.south = box[0], box[1]
        width, height = (box[2] - box[0]) // self.cell + 1, (box[3] - box[1]) // self.cell + 1
        self.mask = np.zeros((height, width), np.uint8)
        self._free = np.zeros((0, 0), np.float32)
        self._stale = True
        if not self.active:
            return
        if window.west > -OPEN:
            self.mask[:, : max(-((self.west - window.west) // self.cell), 0)] = 1
        if window.south > -OPEN:
            self.mask[: max(-((self.south - window.south) // self.cell), 0)] = 1
        if window.east < OPEN:
            self.mask[:, max((window.east - self.west) // self.cell, 0) :] = 1
        if window.north < OPEN:
            self.mask[max((window.north - self.south) // self.cell, 0) :] = 1

    def add_box(self, west: int, south: int, east: int, north: int) -> None:
        """Put a half-open rectangle of local counts in doubt."""
        c0, r0 = max((west - self.west) // self.cell, 0), max((south - self.south) // self.cell, 0)
        c1, r1 = (
            max((east - 1 - self.west) // self.cell + 1, 0),
            max((north - 1 - self.south) // self.cell + 1, 0),
        )
        self.mask[r0:r1, c0:c1] = 1
        self._stale = True

    def add_points(self, x: Int32Array, y: Int32Array, which: npt.NDArray[np.bool_]) -> None:
        """Put the places of the points chosen by the mask in doubt."""
        if self.active and _mark_places(self.mask, self.west, self.south, self.cell, x, y, which):
            self._stale = True

    def triangles(self, vertices: Int32Array, triangles: Int32Array, n: int) -> UInt8:
        """1 for each triangle whose circumcircle may hold a place in doubt, or that has no circle: uint8 [n]."""
        out = np.zeros(n, np.uint8)
        if not self.active or not self.mask.any():
            return out
        if self._stale:
            from scipy.ndimage import distance_transform_edt

            cells = distance_transform_edt(self.mask == 0)
            # From a place in one cell to a place in another: the centres' distance less a diagonal, in cells.
            self._free = np.maximum(cells - math.sqrt(2.0), 0.0).astype(np.float32)
            self._stale = False
        _doubtful_triangles(vertices, triangles, n, self.west, self.south, self.cell, self._free, out)
        return out
