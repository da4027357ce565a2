"""Certificates: the triangles of a window's TIN that points outside the window cannot change.

Positions are uncertified if points outside the window could change the vertices there. A
triangle is the same for any larger cloud if its circumcircle contains no uncertified position.
If a decision used an uncertified triangle, the position of the tested point becomes uncertified
too, since the point may or may not become a vertex. So the uncertified region grows round by
round from the closed sides of the window. Everything that it has not reached is proven equal to
the untiled run. The proof is in ``docs/filters.md``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptd.arrays import Bool, Float32, Int32, UInt8
from ptd.frame import Scale, Window
from ptd.kernel import inlined, kernel
from ptd.tin.mesh import Tin
from ptd.tin.triangles import Mesh, is_ghost

UNCERTIFIED_CELL_M = 2.0
"""Smallest size of the cells of the raster of uncertified positions."""
MAX_RASTER = 1024
"""Number of cells along the longer side of that raster above which its cells become larger."""


class CheckedMesh(NamedTuple):
    """The arrays of a TIN and a mask of its uncertified triangles, as one argument of kernels.

    Attributes
    ----------
    vertices, triangles : int32 arrays, see `ptd.tin.triangles`
    uncertified : uint8 [triangles]
        Result of `UncertifiedRegion.triangles`.
    """

    vertices: Int32
    triangles: Int32
    uncertified: UInt8


@kernel
def _add_positions(
    mask: UInt8,
    west: int,
    south: int,
    cell: int,
    x: Int32,
    y: Int32,
    which: Bool,
) -> bool:
    """Make the positions of the chosen points uncertified, and return whether any of them was certified before."""
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
def _distance_to_side(ax: float, ay: float, bx: float, by: float) -> float:
    """Return the distance from the origin to the segment a b."""
    dx, dy = bx - ax, by - ay
    length2 = dx * dx + dy * dy
    share = min(max(-(ax * dx + ay * dy) / length2, 0.0), 1.0) if length2 > 0.0 else 0.0
    return math.sqrt((ax + share * dx) ** 2 + (ay + share * dy) ** 2)


@kernel
def _add_triangles(
    mask: UInt8, west: int, south: int, cell: int, mesh: Mesh, which: UInt8, reach: float
) -> None:
    """Make all cells within `reach` of the chosen real triangles uncertified, and a few more."""
    vertices, triangles = mesh
    near = reach + math.sqrt(0.5) * cell + 1.0
    corners = np.empty((3, 2), np.float64)
    for t in range(which.size):
        if which[t] == 0 or is_ghost(triangles, t):
            continue
        for j in range(3):
            v = 4 * triangles[8 * t + 4 + j]
            corners[j, 0], corners[j, 1] = vertices[v] - west, vertices[v + 1] - south
        first_column = max(int((corners[:, 0].min() - near) // cell), 0)
        first_row = max(int((corners[:, 1].min() - near) // cell), 0)
        last_column = min(int((corners[:, 0].max() + near) // cell), mask.shape[1] - 1)
        last_row = min(int((corners[:, 1].max() + near) // cell), mask.shape[0] - 1)
        for row in range(first_row, last_row + 1):
            for column in range(first_column, last_column + 1):
                x, y = (column + 0.5) * cell, (row + 0.5) * cell
                inside = True
                for j in range(3):
                    ax, ay = corners[j, 0] - x, corners[j, 1] - y
                    bx, by = corners[(j + 1) % 3, 0] - x, corners[(j + 1) % 3, 1] - y
                    inside = inside and ax * by - ay * bx >= 0.0
                    if _distance_to_side(ax, ay, bx, by) <= near:
                        mask[row, column] = 1
                if inside:
                    mask[row, column] = 1


class _Sides(NamedTuple):
    """West, south, east and north of the known window, of the raster, and of the seed window."""

    known: tuple[float, float, float, float]
    raster: tuple[float, float, float, float]
    seed_window: tuple[float, float, float, float]


@inlined
def _circle_is_uncertified(
    a: tuple[int, int],
    b: tuple[int, int],
    c: tuple[int, int],
    sides: _Sides,
    cell: float,
    distances: Float32,
) -> bool:
    """Return whether the circle through three positions may contain an uncertified position.

    A false yes is possible but rare, a false no is impossible. ``distances`` contains the
    distance in cells from each cell to the nearest uncertified cell.
    """
    ax, ay = float(a[0]), float(a[1])
    bx, by = float(b[0] - a[0]), float(b[1] - a[1])
    cx, cy = float(c[0] - a[0]), float(c[1] - a[1])
    area = 2.0 * (bx * cy - by * cx)
    b2, c2 = bx * bx + by * by, cx * cx + cy * cy
    if abs(area) <= 1e-9 * (abs(bx * cy) + abs(by * cx)):
        return True
    ux, uy = (cy * b2 - by * c2) / area, (bx * c2 - cx * b2) / area
    radius = math.sqrt(ux * ux + uy * uy) * (1.0 + 1e-6) + 1.0
    return _disk_is_uncertified(ax + ux, ay + uy, radius, sides, cell, distances)


@inlined
def _disk_is_uncertified(
    x: float, y: float, radius: float, sides: _Sides, cell: float, distances: Float32
) -> bool:
    """Return whether a disk may contain an uncertified position."""
    if not _within(x, y, radius, sides.known):
        return True
    if not _within(x, y, radius, sides.raster) and not _within(x, y, radius, sides.seed_window):
        return True
    column, row = (x - sides.raster[0]) / cell, (y - sides.raster[1]) / cell
    near_x = min(max(column, 0.0), float(distances.shape[1]))
    near_y = min(max(row, 0.0), float(distances.shape[0]))
    # Let n be the raster's point nearest to a centre beyond it. The angle at n between the
    # centre and any position in the raster is at least 90 degrees. So the squared distance from
    # the centre to the position is at least the sum of their squared distances from n.
    beyond2 = (column - near_x) ** 2 + (row - near_y) ** 2
    certified = float(
        distances[
            min(int(near_y), distances.shape[0] - 1), min(int(near_x), distances.shape[1] - 1)
        ]
    )
    return (
        radius
        >= (math.sqrt(beyond2 + certified * certified) if beyond2 > 0.0 else certified) * cell
    )


@kernel
def _within(
    x: float, y: float, radius: float, sides: tuple[float, float, float, float]
) -> bool:
    """Return whether a disk lies within west, south, east, north."""
    return bool(
        x - radius >= sides[0]
        and y - radius >= sides[1]
        and x + radius < sides[2]
        and y + radius < sides[3]
    )


@kernel
def _uncertified_triangles(
    mesh: Mesh, sides: _Sides, cell: int, distances: Float32, out: UInt8
) -> None:
    vertices, triangles = mesh
    for t in range(out.size):
        if is_ghost(triangles, t):
            out[t] = 1
            continue
        i, j, k = 4 * triangles[8 * t + 4], 4 * triangles[8 * t + 5], 4 * triangles[8 * t + 6]
        a, b, c = (
            (vertices[i], vertices[i + 1]),
            (vertices[j], vertices[j + 1]),
            (vertices[k], vertices[k + 1]),
        )
        out[t] = _circle_is_uncertified(a, b, c, sides, float(cell), distances)


@kernel
def _uncertified_disks(
    x: Int32,
    y: Int32,
    radius: float,
    sides: _Sides,
    cell: float,
    distances: Float32,
    out: Bool,
) -> None:
    for i in range(x.size):
        out[i] = _disk_is_uncertified(float(x[i]), float(y[i]), radius, sides, cell, distances)


class UncertifiedRegion:
    """Region of uncertified positions: everything outside the known window, and a raster of cells inside it.

    Parameters
    ----------
    known : Window
        Window in which all candidates and their states are known.
    seed_window : Window
        Window within `known`. The part of this window outside the raster is certified, because no real or virtual seed
        can appear or vanish there.
    box : (int, int, int, int)
        West, south, east, north of the raster in local counts.
    scale : Scale
    """

    def __init__(
        self, known: Window, seed_window: Window, box: tuple[int, int, int, int], scale: Scale
    ) -> None:
        self.active, self.known, self.box = known.closed, known, box
        span = max(box[2] - box[0], box[3] - box[1], 1)
        self.cell = (
            max(int(scale.counts(UNCERTIFIED_CELL_M)), -(-span // MAX_RASTER))
            if self.active
            else span
        )
        self.west, self.south = box[0], box[1]
        width, height = (box[2] - box[0]) // self.cell + 1, (box[3] - box[1]) // self.cell + 1
        self.mask = np.zeros((height, width), np.uint8)
        east, north = self.west + width * self.cell, self.south + height * self.cell
        self._sides = _Sides(
            _floats(known),
            _floats(Window(self.west, self.south, east, north)),
            _floats(seed_window),
        )
        self._free = np.zeros((0, 0), np.float32)
        self._stale = True

    def add_box(self, west: int, south: int, east: int, north: int) -> None:
        """Make a half-open rectangle of local counts uncertified."""
        c0, r0 = (
            max((west - self.west) // self.cell, 0),
            max((south - self.south) // self.cell, 0),
        )
        c1, r1 = (
            max((east - 1 - self.west) // self.cell + 1, 0),
            max((north - 1 - self.south) // self.cell + 1, 0),
        )
        self.mask[r0:r1, c0:c1] = 1
        self._stale = True

    def add_points(self, x: Int32, y: Int32, which: Bool) -> bool:
        """Make the positions of points in a mask uncertified, and return whether any of them was certified before."""
        new = self.active and _add_positions(
            self.mask, self.west, self.south, self.cell, x, y, which
        )
        self._stale = self._stale or new
        return new

    def add_triangles(self, tin: Tin, which: UInt8, reach: float) -> None:
        """Make all positions within `reach` counts of the chosen real triangles uncertified."""
        if self.active:
            _add_triangles(self.mask, self.west, self.south, self.cell, tin.mesh, which, reach)
            self._stale = True

    def covers(self, x: Int32, y: Int32) -> Bool:
        """Return whether positions in local counts are uncertified: bool [n]."""
        if not self.active:
            return np.zeros(x.size, np.bool_)
        k = self.known
        beyond = (x < k.west) | (y < k.south) | (x >= k.east) | (y >= k.north)
        column = np.clip(
            (x.astype(np.int64) - self.west) // self.cell, 0, self.mask.shape[1] - 1
        )
        row = np.clip((y.astype(np.int64) - self.south) // self.cell, 0, self.mask.shape[0] - 1)
        is_uncertified: Bool = beyond | (self.mask[row, column] != 0)
        return is_uncertified

    def triangles(self, tin: Tin) -> UInt8:
        """Return 1 for each uncertified triangle, else 0: uint8 [triangles].

        The circumcircle of an uncertified triangle may contain an uncertified position, or the
        triangle has no circle.
        """
        out = np.zeros(tin.n_triangles, np.uint8)
        if self.active:
            _uncertified_triangles(tin.mesh, self._sides, self.cell, self._fresh(), out)
        return out

    def near(self, x: Int32, y: Int32, radius: float) -> Bool:
        """Return whether an uncertified position may lie within a radius of positions: bool [n].

        The radius is in counts, positions are local counts.
        """
        out = np.zeros(x.size, np.bool_)
        if self.active:
            _uncertified_disks(
                x, y, float(radius), self._sides, float(self.cell), self._fresh(), out
            )
        return out

    def _fresh(self) -> Float32:
        """Return the certified distance around each cell (`_free_cells`) for the current raster."""
        if self._stale:
            self._free = _free_cells(self.mask)
            self._stale = False
        return self._free


def _floats(window: Window) -> tuple[float, float, float, float]:
    return float(window.west), float(window.south), float(window.east), float(window.north)


def _free_cells(mask: UInt8) -> Float32:
    """Return the least distance in cells of positions in each cell from uncertified cells: float32 [rows, columns]."""
    if not mask.any():
        return np.full(mask.shape, np.inf, np.float32)
    from scipy.ndimage import distance_transform_edt

    cells = distance_transform_edt(mask == 0)
    # Positions in two cells are at most a diagonal nearer to each other than the centres are.
    return np.maximum(cells - math.sqrt(2.0), 0.0).astype(np.float32)
