"""Distance and angle of points to a fixed TIN, as a test or as a histogram of both.

The outer contour of the histogram gives thresholds. The vertices of the TIN are random points
of cells, chosen by hashes of coordinates, so they are the same for any tile or order of points.

Sources: Dong 2017 (004), sections 3.2 and 3.3.4; Dong 2018, 2.5.3 and figure 5.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptd.arrays import Bool, Int32, Int64, UInt8, UInt32, UInt64
from ptd.cells import Xyz, lowest_per_cell
from ptd.frame import CellLattice, Scale
from ptd.ground.certificates import UncertifiedRegion
from ptd.ground.criteria import across, facet_measures
from ptd.kernel import kernel
from ptd.tin.facets import Rule, canonical_facet, facet_passes
from ptd.tin.mesh import Locator, Tin, start_near
from ptd.tin.triangles import Mesh, coincident_vertex, locate

ANY_EDGE = 2**62
"""Square of a length that no edge reaches."""


class Threshold(NamedTuple):
    """Largest distance in metres of a point to its facet's plane, and largest angle in radians (`Trial`)."""

    distance_m: float
    angle_rad: float


class Bins(NamedTuple):
    """Width and number of the bins of a histogram of distances (metres) and angles (radians).

    Points beyond the bins are not counted.
    """

    distance_m: float
    distances: int
    angle_rad: float
    angles: int


class TrialArrays(NamedTuple):
    """Arrays and settings with which kernels test points.

    Attributes
    ----------
    mesh : Mesh
    usable : bool [triangles]
        Mask of the facets whose circumcircles are not too wide.
    uncertified : uint8 [triangles]
        Mask of uncertified triangles (`ptd.ground.certificates.UncertifiedRegion.triangles`).
    locator : Locator
    z_ratio : float
        Horizontal counts in one vertical count.
    largest : bool
        Whether the largest angle counts (`Trial`).
    """

    mesh: Mesh
    usable: Bool
    uncertified: UInt8
    locator: Locator
    z_ratio: float
    largest: bool


@kernel
def _gauge(
    vertices: Int32,
    triangles: Int32,
    t: int,
    x: int,
    y: int,
    z: int,
    z_ratio: float,
    largest: bool,
) -> tuple[float, float]:
    """Return the unsigned distance to a real facet's plane, and the distance to its nearest or farthest corner.

    Both are horizontal counts. The largest angle between the plane and the lines to the corners
    is that to the nearest corner, and the smallest that to the farthest.
    """
    distance, nearest, _cos2, _edge = facet_measures(vertices, triangles, t, x, y, z, z_ratio)
    if largest:
        return abs(distance), nearest
    distance = abs(distance)
    farthest2 = 0.0
    for v in canonical_facet(vertices, triangles, t):
        dx, dy = float(x - vertices[4 * v]), float(y - vertices[4 * v + 1])
        dz = float(z - vertices[4 * v + 2]) * z_ratio
        farthest2 = max(farthest2, dx * dx + dy * dy + dz * dz)
    return distance, math.sqrt(farthest2)


@kernel
def _usable(mesh: Mesh, n: int, rule: Rule) -> Bool:
    vertices, triangles = mesh
    out = np.zeros(n, np.bool_)
    for t in range(n):
        out[t] = facet_passes(vertices, triangles, t, rule)
    return out


@kernel
def _owner(
    vertices: Int32,
    triangles: Int32,
    usable: Bool,
    uncertified: UInt8,
    t: int,
    x: int,
    y: int,
) -> tuple[int, bool]:
    """Return the usable facet at a position that is not a vertex, or -1, and whether it is certified.

    On an edge it is the facet that `locate` gives, or the one across the edge if only that is
    usable. The result is certified only if both are usable and certified.
    """
    beside = across(vertices, triangles, t, x, y)
    owner = t if usable[t] else (beside if usable[beside] else -1)
    return owner, bool(
        usable[t] and usable[beside] and uncertified[t] == 0 and uncertified[beside] == 0
    )


@kernel
def _test(
    tested: TrialArrays, points: Xyz, which: Bool, near: Bool, distance: float, sine: float
) -> tuple[Bool, Bool]:
    (vertices, triangles), usable, uncertified, locator, z_ratio, largest = tested
    x, y, z = points
    passed, uncertified_points = np.zeros(x.size, np.bool_), np.zeros(x.size, np.bool_)
    for i in range(x.size):
        if not which[i]:
            continue
        t = locate(vertices, triangles, x[i], y[i], start_near(locator, x[i], y[i]))
        v = coincident_vertex(vertices, triangles, x[i], y[i], t)
        if v >= 0:
            passed[i] = abs(float(z[i]) - float(vertices[4 * v + 2])) * z_ratio <= distance
            uncertified_points[i] = near[i] and uncertified[t] != 0
            continue
        owner, is_certified = _owner(vertices, triangles, usable, uncertified, t, x[i], y[i])
        uncertified_points[i] = near[i] and not is_certified
        if owner >= 0:
            off, corner = _gauge(vertices, triangles, owner, x[i], y[i], z[i], z_ratio, largest)
            passed[i] = off <= distance and off <= corner * sine
    return passed, uncertified_points


@kernel
def _count(
    tested: TrialArrays, points: Xyz, which: Bool, distance: float, angle: float, counts: Int64
) -> None:
    (vertices, triangles), usable, uncertified, locator, z_ratio, largest = tested
    x, y, z = points
    for i in range(x.size):
        if not which[i]:
            continue
        t = locate(vertices, triangles, x[i], y[i], start_near(locator, x[i], y[i]))
        if coincident_vertex(vertices, triangles, x[i], y[i], t) >= 0:
            continue
        owner, _is_certified = _owner(vertices, triangles, usable, uncertified, t, x[i], y[i])
        if owner < 0:
            continue
        off, corner = _gauge(vertices, triangles, owner, x[i], y[i], z[i], z_ratio, largest)
        row, column = int(off / distance), int(math.asin(min(off / corner, 1.0)) / angle)
        if row < counts.shape[0] and column < counts.shape[1]:
            counts[row, column] += 1


class Trial:
    """A fixed TIN against which points are tested.

    A facet with a circumradius above `widest_m` does not describe the ground within it, so its
    points are not tested. This limits the data that a window needs for certified results. A
    facet that is not wide is certified if its circle contains no uncertified position.

    Where the facet of the window's TIN is wide, the TIN of the untiled run could have a facet
    that is not wide. The vertices of such a facet lie within 2 `widest_m` of the position. If
    no uncertified position is that near, the window's TIN would have this facet as well
    (`docs/filters.md`, Certificates). A position on an edge between a wide facet and another
    one belongs to the other one.

    Parameters
    ----------
    tin : Tin
    scale : Scale
    widest_m : float
        Largest circumradius in metres.
    region : UncertifiedRegion, optional
        Current uncertified region of the TIN.
    largest : bool
        Whether a point's angle is the largest of the three (Axelsson; Dong 2018), not the smallest (Dong 2017).
    """

    def __init__(
        self,
        tin: Tin,
        scale: Scale,
        widest_m: float,
        region: UncertifiedRegion | None = None,
        largest: bool = False,
    ) -> None:
        self.tin, self.scale, self.radius = tin, scale, scale.counts(widest_m)
        self.usable = _usable(tin.mesh, tin.n_triangles, Rule(ANY_EDGE, self.radius))
        if self.usable.size:
            uncertified = (
                np.zeros(tin.n_triangles, np.uint8) if region is None else region.triangles(tin)
            )
            self._tested = TrialArrays(
                tin.mesh, self.usable, uncertified, Locator.of(tin), scale.z_ratio, largest
            )

    def test(
        self,
        x: Int32,
        y: Int32,
        z: Int32,
        which: Bool,
        threshold: Threshold,
        region: UncertifiedRegion,
    ) -> tuple[Bool, Bool]:
        """Test the chosen points.

        Parameters
        ----------
        x, y, z : int32 [n]
            Local counts.
        which : bool [n]
            Mask of the points to test.
        threshold : Threshold
            Limits of distance and angle, which must both hold. At a vertex, where any of its facets may be found, only
            the height above the vertex counts.
        region : UncertifiedRegion
            Uncertified region of the TIN, which may have grown since.

        Returns
        -------
        passed : bool [n]
        uncertified_points : bool [n]
            Mask of the results that points outside the window could change.
        """
        near = np.zeros(x.size, np.bool_)
        near[which] = region.near(x[which], y[which], 2.0 * self.radius)
        if not self.usable.size:
            return np.zeros(x.size, np.bool_), near
        distance, sine = self.scale.counts(threshold.distance_m), math.sin(threshold.angle_rad)
        return _test(self._tested, Xyz(x, y, z), which, near, distance, sine)

    def count(self, x: Int32, y: Int32, z: Int32, which: Bool, bins: Bins) -> Int64:
        """Return the histogram of distances and angles of the chosen points that are not at vertices.

        It is int64 [distances, angles]. ``largest`` of the class selects the angle.
        """
        counts = np.zeros((bins.distances, bins.angles), np.int64)
        if self.usable.size:
            distance = self.scale.counts(bins.distance_m)
            _count(self._tested, Xyz(x, y, z), which, distance, bins.angle_rad, counts)
        return counts


_JOINED = np.array([[1, 1, 0], [1, 1, 1], [0, 1, 1]])
"""Neighbours along the axes and along the diagonal that splits a square into triangles."""
_STEPS = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1)]


def contour_reach(counts: Int64, level: float) -> tuple[float, float] | None:
    """Return the largest first and second coordinate of the contour around the fullest bin.

    Counts are values at the middles of their bins and are interpolated over triangles, two per
    square, as the paper does with scattered points. Beyond the histogram they are 0. If there
    are several contours at the level, the one around the fullest bin counts (the first of equal
    bins), because islands farther out are other populations.

    Parameters
    ----------
    counts : int64 [a, b]
    level : float
        Level of the contour, above 0.

    Returns
    -------
    (float, float) or None
        Coordinates in bins from the origin; None if no bin reaches the level.
    """
    from scipy.ndimage import label

    high = np.pad(counts, 1) >= level
    values = np.pad(counts, 1).astype(np.float64)
    peak = np.unravel_index(int(np.argmax(values)), values.shape)
    if not high[peak]:
        return None
    parts, _ = label(high, _JOINED)
    rows, columns = np.nonzero(parts == parts[peak])
    reach = [0.0, 0.0]
    for down, right in _STEPS:
        within, beyond = values[rows, columns], values[rows + down, columns + right]
        out = np.flatnonzero(beyond < level)
        if out.size:
            share = (within[out] - level) / (within[out] - beyond[out])
            # The pad adds one bin, and the value is at the middle of its bin.
            reach[0] = max(reach[0], float((rows[out] + down * share).max()) - 0.5)
            reach[1] = max(reach[1], float((columns[out] + right * share).max()) - 0.5)
    return reach[0], reach[1]


def _mixed64(values: UInt64) -> UInt64:
    """Mix bits by SplitMix64 (Steele, Lea and Flood 2014): each bit of the input changes half of the bits."""
    values = values + np.uint64(0x9E3779B97F4A7C15)
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return values ^ (values >> np.uint64(31))


def _mixed32(values: UInt32) -> UInt32:
    """Mix bits by the finaliser of MurmurHash3, which is one-to-one."""
    values = (values ^ (values >> np.uint32(16))) * np.uint32(0x85EBCA6B)
    values = (values ^ (values >> np.uint32(13))) * np.uint32(0xC2B2AE35)
    return values ^ (values >> np.uint32(16))


def point_hashes(x: Int32, y: Int32, z: Int32, cells: CellLattice, salt: int) -> Int32:
    """Return a random number for each point from its absolute position and a salt: int32 [n].

    Points at one (x, y) with different heights have different numbers. So ties in
    `random_per_cell` are only between different positions in plan, or between equal points.
    """
    with np.errstate(over="ignore"):
        east = (x.astype(np.int64) + cells.origin_x).view(np.uint64)
        north = (y.astype(np.int64) + cells.origin_y).view(np.uint64)
        position_hashes = _mixed64(
            _mixed64(east + _mixed64(np.full(1, salt, np.uint64))) + north
        )
        return _mixed32(position_hashes.astype(np.uint32) ^ z.view(np.uint32)).view(np.int32)


def random_per_cell(x: Int32, y: Int32, z: Int32, cells: CellLattice, salt: int) -> Int32:
    """Pick one random point of each occupied cell, in row-major order of the cells.

    The pick depends only on the cell's own points and the salt, not on their order, the tile or
    the frame's offset.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts.
    cells : CellLattice
    salt : int
        Seed of the picks, at least 0.

    Returns
    -------
    int32 [m]
        Indices of the picked points.
    """
    if x.size == 0:
        return np.zeros(0, np.int32)
    return lowest_per_cell(
        x, y, point_hashes(x, y, np.ascontiguousarray(z), cells, salt), cells
    )
