"""Ridge points: additional seeds where the TIN of the seeds cuts off a ridge.

Source: Remote Sensing 8(1):71 (2016), section 2.1. A cell's lowest point lies on a slope, never
on the ridge above it. So the seeds of both slopes are connected by facets with long sides, from
which the surroundings fall away. Points are sorted by cell and height (`Stacks`), for a fast
search of the lowest point that passes a test.
"""

from __future__ import annotations

import math
from dataclasses import astuple
from typing import NamedTuple, Self

import numpy as np

from ptd.arrays import Bool, Int32, Int64, UInt8
from ptd.cells import CellIndex, CellTable, Xyz, is_lower, slot_of
from ptd.frame import CellLattice, Scale
from ptd.ground.certificates import UncertifiedRegion
from ptd.kernel import as_int64, kernel
from ptd.tin.facets import canonical_facet
from ptd.tin.mesh import Tin
from ptd.tin.triangles import Mesh, is_ghost

SMALL_STACK = 24
"""Largest stack for which insertion sort alone is faster."""


@kernel
def _sort_stacks(x: Int32, y: Int32, z: Int32, starts: Int64, order: Int64) -> None:
    for k in range(starts.size - 1):
        first, end = starts[k], starts[k + 1]
        if end - first > SMALL_STACK:  # sort by height first; insertion then only settles ties
            part = order[first:end].copy()
            order[first:end] = part[np.argsort(z[part])]
        for j in range(first + 1, end):
            moving = order[j]
            position = j
            while position > first and is_lower(x, y, z, moving, order[position - 1]):
                order[position] = order[position - 1]
                position -= 1
            order[position] = moving


class StackIndex(NamedTuple):
    """Stacks of points by cell, for kernels (`ptd.cells.CellIndex`, `ptd.frame.CellLattice`)."""

    table: CellTable
    col0: int
    row0: int
    p: int
    q: int
    origin_x: int
    origin_y: int


class Stacks:
    """Points sorted by the cells of a lattice in row-major order, and within a cell by (z, x, y).

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts, at least one point.
    cells : CellLattice

    Attributes
    ----------
    x, y, z : int32 [n]
        Sorted coordinates.
    starts : int64 [m + 1]
        Stack k holds the points ``starts[k]`` to ``starts[k + 1] - 1``; no stack is empty.
    raster : StackIndex
    """

    def __init__(self, x: Int32, y: Int32, z: Int32, cells: CellLattice) -> None:
        index = CellIndex(x, y, cells)
        table = index.table
        _sort_stacks(x, y, z, table.starts, table.order)
        self.x, self.y, self.z = x[table.order], y[table.order], z[table.order]
        self.starts = table.starts
        self.raster = StackIndex(
            table, index.col0, index.row0, cells.p, cells.q, cells.origin_x, cells.origin_y
        )


@kernel
def lowest_within(
    x: Int32, y: Int32, z: Int32, raster: StackIndex, x3: int, y3: int, radius: float
) -> int:
    """The lowest point within a radius of the position (x3 / 3, y3 / 3), or -1.

    Among equal heights the lexicographically smallest (x, y) is taken. Distances are compared
    exactly.

    Parameters
    ----------
    x, y, z : int32 [n]
        Arrays of `Stacks`.
    raster : StackIndex
    x3, y3 : int64
        Three times the position in local counts, such as the sum of a facet's corners.
    radius : float
        Counts.
    """
    half_width = int(radius) + 2
    x0, y0 = x3 // 3 - half_width + raster.origin_x, y3 // 3 - half_width + raster.origin_y
    limit2 = 9.0 * radius * radius
    best = -1
    for row in range(
        y0 * raster.q // raster.p, (y0 + 2 * half_width) * raster.q // raster.p + 1
    ):
        for column in range(
            x0 * raster.q // raster.p, (x0 + 2 * half_width) * raster.q // raster.p + 1
        ):
            slot = slot_of(raster.table, column - raster.col0, row - raster.row0)
            if slot < 0:
                continue
            for i in range(raster.table.starts[slot], raster.table.starts[slot + 1]):
                dx, dy = np.int64(3) * x[i] - x3, np.int64(3) * y[i] - y3
                if dx * dx + dy * dy <= limit2:
                    if best < 0 or is_lower(x, y, z, i, best):
                        best = i
                    break  # later points of the stack are not lower
    return best


@kernel
def indices_in_stacks(
    of_x: Int32, of_y: Int32, of_z: Int32, x: Int32, y: Int32, z: Int32, raster: StackIndex
) -> Int32:
    """Index of each point within `Stacks`, -1 for points that are not in it: int32 [n].

    Parameters
    ----------
    of_x, of_y, of_z : int32 [n]
        Local counts, in any order. For points at one position any of their indices may result.
    x, y, z : int32
        Arrays of `Stacks`.
    raster : StackIndex
    """
    indices = np.full(of_x.size, -1, np.int32)
    for k in range(of_x.size):
        column = (as_int64(of_x[k]) + raster.origin_x) * raster.q // raster.p - raster.col0
        row = (as_int64(of_y[k]) + raster.origin_y) * raster.q // raster.p - raster.row0
        slot = slot_of(raster.table, column, row)
        if slot < 0:
            continue
        for i in range(raster.table.starts[slot], raster.table.starts[slot + 1]):
            if z[i] > of_z[k]:
                break
            if z[i] == of_z[k] and x[i] == of_x[k] and y[i] == of_y[k]:
                indices[k] = i
                break
    return indices


AROUND = 9
"""Largest number of facets around a facet: three beside it, and two more beside each of
those."""


class RidgeRule(NamedTuple):
    """Limits for a facet on a ridge, in horizontal counts.

    Attributes
    ----------
    side : float
        m_r w (equation 1): some side has to be longer than this in x or in y.
    cosine : float
        Cosine of theta_r, the smallest dihedral angle to the facets that fall away.
    radius : float
        Radius around the centre of gravity in which the lowest point is the ridge point.
    z_ratio : float
        Horizontal counts in one vertical count.
    """

    side: float
    cosine: float
    radius: float
    z_ratio: float

    @classmethod
    def of(cls, scale: Scale, *, side_m: float, angle_deg: float, radius_m: float) -> Self:
        """The rule with limits in metres and degrees."""
        cosine = math.cos(math.radians(angle_deg))
        return cls(scale.counts(side_m), cosine, scale.counts(radius_m), scale.z_ratio)


@kernel
def _normal(
    vertices: Int32, triangles: Int32, t: int, z_ratio: float
) -> tuple[float, float, float]:
    """Return an upward normal of a real facet, with bits that do not depend on the facet's number or rotation."""
    a, b, c = canonical_facet(vertices, triangles, t)
    ax, ay, az = vertices[4 * a], vertices[4 * a + 1], vertices[4 * a + 2]
    bx, by = float(vertices[4 * b] - ax), float(vertices[4 * b + 1] - ay)
    cx, cy = float(vertices[4 * c] - ax), float(vertices[4 * c + 1] - ay)
    bz, cz = (vertices[4 * b + 2] - az) * z_ratio, (vertices[4 * c + 2] - az) * z_ratio
    return by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx


@kernel
def _has_long_side(vertices: Int32, triangles: Int32, t: int, side: float) -> bool:
    """Whether max(|dx|, |dy|) of some side is above the limit (equation 1)."""
    for j in range(3):
        a = 4 * triangles[8 * t + 4 + j]
        b = 4 * triangles[8 * t + 4 + (j + 1) % 3]
        if max(abs(vertices[a] - vertices[b]), abs(vertices[a + 1] - vertices[b + 1])) > side:
            return True
    return False


@kernel
def _falls_away(
    vertices: Int32,
    triangles: Int32,
    t: int,
    other: int,
    cosine: float,
    z_ratio: float,
) -> bool:
    """Assumption 2, (i) and (ii): the dihedral angle exceeds the limit, `other`'s centre lies below t's plane."""
    nx, ny, nz = _normal(vertices, triangles, t, z_ratio)
    mx, my, mz = _normal(vertices, triangles, other, z_ratio)
    dot = nx * mx + ny * my + nz * mz
    lengths = math.sqrt((nx * nx + ny * ny + nz * nz) * (mx * mx + my * my + mz * mz))
    if dot >= cosine * lengths:
        return False
    a = 4 * canonical_facet(vertices, triangles, t)[0]
    i, j, k = (
        4 * triangles[8 * other + 4],
        4 * triangles[8 * other + 5],
        4 * triangles[8 * other + 6],
    )
    dx = np.int64(vertices[i]) + vertices[j] + vertices[k] - 3 * np.int64(vertices[a])
    dy = (
        np.int64(vertices[i + 1])
        + vertices[j + 1]
        + vertices[k + 1]
        - 3 * np.int64(vertices[a + 1])
    )
    dz = (
        np.int64(vertices[i + 2])
        + vertices[j + 2]
        + vertices[k + 2]
        - 3 * np.int64(vertices[a + 2])
    )
    return nx * float(dx) + ny * float(dy) + nz * (float(dz) * z_ratio) < 0.0


@kernel
def _of_data(triangles: Int32, t: int, data: Bool) -> bool:
    """Whether a real facet has no virtual corner."""
    row = 8 * t + 4
    return bool(data[triangles[row]] and data[triangles[row + 1]] and data[triangles[row + 2]])


@kernel
def _long_facet(vertices: Int32, triangles: Int32, t: int, data: Bool, side: float) -> bool:
    """Assumption 1, for facets without virtual corners."""
    return _of_data(triangles, t, data) and _has_long_side(vertices, triangles, t, side)


@kernel
def _share_a_vertex(triangles: Int32, s: int, t: int) -> bool:
    for i in range(8 * s + 4, 8 * s + 7):
        for j in range(8 * t + 4, 8 * t + 7):
            if triangles[i] == triangles[j]:
                return True
    return False


@kernel
def _around(triangles: Int32, t: int, found: Int32) -> int:
    """Write the real facets next to t, and those next to them, to `found`. Some may occur twice."""
    n = 0
    for j in range(3):
        s = triangles[8 * t + j] >> 3
        if is_ghost(triangles, s):
            continue
        found[n] = s
        n += 1
        for k in range(3):
            u = triangles[8 * s + k] >> 3
            if u != t and not is_ghost(triangles, u):
                found[n] = u
                n += 1
    return n


@kernel
def ridge_facet(
    vertices: Int32,
    triangles: Int32,
    t: int,
    data: Bool,
    rule: RidgeRule,
    found: Int32,
) -> bool:
    """Whether a real facet lies on a ridge.

    Parameters
    ----------
    vertices, triangles : int32 arrays, see `ptd.tin.triangles`
    t : int
    data : bool [vertices]
        False for virtual seeds. The slope of a facet with a virtual corner is artificial, so it proves no ridge.
    rule : RidgeRule
    found : int32 [AROUND]
        Scratch.
    """
    if not _long_facet(vertices, triangles, t, data, rule.side):
        return False
    falling = 0
    for k in range(_around(triangles, t, found)):
        s = found[k]
        if _of_data(triangles, s, data) and _falls_away(
            vertices, triangles, t, s, rule.cosine, rule.z_ratio
        ):
            found[falling] = s
            falling += 1
    # (iii): two of them share no point, so they lie on different sides
    for i in range(falling):
        for j in range(i):
            if not _share_a_vertex(triangles, found[i], found[j]):
                return True
    return False


@kernel
def _ridge_points(
    mesh: Mesh,
    n: int,
    data: Bool,
    rule: RidgeRule,
    uncertified: UInt8,
    stacks: Xyz,
    raster: StackIndex,
    known: tuple[int, int, int, int],
) -> tuple[Int32, Bool, Bool]:
    """Ridge point of each facet that is or may be a ridge, whether it is uncertified, whether it is a ridge."""
    vertices, triangles = mesh
    x, y, z = stacks
    west, south, east, north = known
    points, uncertified_points, chosen = (
        np.empty(n, np.int32),
        np.empty(n, np.bool_),
        np.empty(n, np.bool_),
    )
    triangles_around = np.empty(AROUND, np.int32)
    m = 0
    for t in range(n):
        if is_ghost(triangles, t):
            continue
        if not _long_facet(vertices, triangles, t, data, rule.side):
            continue  # If t itself is uncertified, the positions near it are too.
        is_uncertified = False
        for k in range(_around(triangles, t, triangles_around)):
            is_uncertified = is_uncertified or uncertified[triangles_around[k]] != 0
        ridge = ridge_facet(vertices, triangles, t, data, rule, triangles_around)
        if not (ridge or is_uncertified):
            continue
        x3, y3 = as_int64(0), as_int64(0)
        for j in range(8 * t + 4, 8 * t + 7):
            x3 += as_int64(vertices[4 * triangles[j]])
            y3 += as_int64(vertices[4 * triangles[j] + 1])
        i = lowest_within(x, y, z, raster, x3, y3, rule.radius)
        if i < 0:
            continue
        cx, cy = x3 / 3.0, y3 / 3.0
        inside = cx - rule.radius >= west and cx + rule.radius < east
        inside = inside and cy - rule.radius >= south and cy + rule.radius < north
        points[m], uncertified_points[m], chosen[m] = i, is_uncertified or not inside, ridge
        m += 1
    return points[:m].copy(), uncertified_points[:m].copy(), chosen[:m].copy()


def ridge_points(
    tin: Tin, data: Bool, stacks: Stacks, rule: RidgeRule, region: UncertifiedRegion
) -> Int32:
    """Indices of the lowest points near the centres of facets on ridges: int32, ascending, without repetition.

    Parameters
    ----------
    tin : Tin
        TIN of the seeds.
    data : bool [vertices]
        False for virtual seeds.
    stacks : Stacks
        Points that may become seeds.
    rule : RidgeRule
    region : UncertifiedRegion
        Uncertified region, to which the positions are added where points outside the window could make or move a ridge
        point. They lie within the radius of uncertified facets, or are ridge points of facets near those.
    """
    n = tin.n_triangles
    uncertified = region.triangles(tin)
    xyz, known = Xyz(stacks.x, stacks.y, stacks.z), astuple(region.known)
    points, uncertified_points, chosen = _ridge_points(
        tin.mesh, n, data, rule, uncertified, xyz, stacks.raster, known
    )
    region.add_triangles(tin, uncertified, rule.radius)
    region.add_points(stacks.x[points], stacks.y[points], uncertified_points)
    return np.unique(points[chosen])
