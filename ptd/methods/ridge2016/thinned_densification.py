"""Densification in little memory: after each round only the lowest terrain point of a cell stays in the TIN.

Source: Remote Sensing 8(1):71 (2016), section 2.3. All other points are tested again in each
round. In a cloud that was thinned beforehand, a lowest point that is not terrain could hide a
terrain point of its cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ptd.arrays import Bool, Int32, Int64, UInt8
from ptd.cells import Xyz
from ptd.ground.certificates import CheckedMesh, UncertifiedRegion
from ptd.ground.criteria import FacetLimits, accepts
from ptd.ground.densify import tin_with_ring
from ptd.ground.labelling import is_terrain
from ptd.kernel import as_int64, kernel
from ptd.methods.ridge2016.ridges import Stacks
from ptd.tin.facets import canonical_facet
from ptd.tin.mesh import Tin
from ptd.tin.triangles import Mesh, is_ghost, locate


@kernel
def _test_stacks(
    mesh: CheckedMesh,
    points: Xyz,
    starts: Int64,
    limits: FacetLimits,
    vertex: Bool,
    uncertified_points: Bool,
) -> Bool:
    """One round: mask of the lowest terrain points of their cells.

    A cell is tested upwards from its lowest point until one belongs to the terrain for certain, because no higher point
    can become the cell's vertex. Points that may become it depending on data outside the window are added to
    `uncertified_points`: points below the certain one whose test is uncertified, and in that case the
    certain one as well.
    """
    vertices, triangles, uncertified = mesh
    x, y, z = points
    kept = np.zeros(x.size, np.bool_)
    t = 0
    for k in range(starts.size - 1):
        lowest = -1
        any_uncertified = False
        for i in range(starts[k], starts[k + 1]):
            is_uncertified = uncertified_points[i]
            passed = vertex[i]
            if not passed:
                t = locate(vertices, triangles, x[i], y[i], t)
                if is_ghost(triangles, t):
                    is_uncertified = is_uncertified or uncertified[t] != 0
                else:
                    passed, _, result_is_uncertified = accepts(
                        vertices, triangles, uncertified, t, (x[i], y[i], z[i]), limits
                    )
                    is_uncertified = is_uncertified or result_is_uncertified
            if passed and lowest < 0:
                lowest = i
            if is_uncertified:
                uncertified_points[i] = any_uncertified = True
            elif passed:
                uncertified_points[i] = any_uncertified
                break
        if lowest >= 0:
            kept[lowest] = True
    return kept


@kernel
def _same_corners(mesh: Mesh, t: int, other: Mesh, u: int) -> bool:
    """Whether a real triangle has the corners, heights included, of a triangle in another TIN."""
    (vertices, triangles), (other_vertices, other_triangles) = mesh, other
    if is_ghost(triangles, t) or is_ghost(other_triangles, u):
        return False
    corners, other_corners = (
        canonical_facet(vertices, triangles, t),
        canonical_facet(other_vertices, other_triangles, u),
    )
    for i in range(3):
        for k in range(3):
            if vertices[4 * corners[i] + k] != other_vertices[4 * other_corners[i] + k]:
                return False
    return True


class _Labelled(NamedTuple):
    """Label of each point, and the triangle that it rests on, in the last TIN.

    Attributes
    ----------
    home : int32 [n]
        Triangle of each point, initially -1.
    again : bool [n]
        Whether the label also rests on other triangles.
    terrain : bool [n]
    """

    home: Int32
    again: Bool
    terrain: Bool


@kernel
def _tally(
    last: Mesh,
    mesh: CheckedMesh,
    points: Xyz,
    limits: FacetLimits,
    floor: float,
    now: Int32,
    labelled: _Labelled,
) -> tuple[int, int]:
    """Label the points whose triangle changed.

    Returns the number of new terrain points, and of all points whose label is uncertified.

    Parameters
    ----------
    last : Mesh
        The TIN in which `home` was found.
    now : int32 [triangles of `last`]
        Filled with -1; receives the present number of each triangle, -2 for changed ones.
    """
    vertices, triangles, uncertified = mesh
    x, y, z = points
    home, again, terrain = labelled
    n_gained = n_uncertified = t = 0
    for i in range(x.size):
        h = as_int64(home[i])
        if h >= 0 and not again[i] and now[h] == -1:
            t = locate(vertices, triangles, x[i], y[i], t)
            same = _same_corners(last, h, Mesh(vertices, triangles), t)
            now[h] = -2
            if same:
                now[h] = t
        if h >= 0 and not again[i] and now[h] >= 0:
            t = as_int64(now[h])
            is_uncertified = uncertified[t] != 0
        else:
            t = locate(vertices, triangles, x[i], y[i], t)
            is_now, again[i], is_uncertified = is_terrain(
                vertices, triangles, uncertified, t, (x[i], y[i], z[i]), limits, floor
            )
            n_gained += is_now and not terrain[i]
            terrain[i] = is_now
        home[i] = t
        n_uncertified += is_uncertified
    return n_gained, n_uncertified


class GrowthCounter:
    """Counter of the points that join the terrain class in successive TINs, which labels only changed triangles again.

    Parameters
    ----------
    x, y, z : int32 [n]
        Coordinates; neighbours in the array should be near each other.
    limits : FacetLimits
    floor : float
        Floor of `ptd.ground.labelling.label_points`, whose labels are counted.
    terrain : bool [n]
        The terrain class; at first the seeds. Updated in place.
    """

    def __init__(
        self, x: Int32, y: Int32, z: Int32, limits: FacetLimits, floor: float, terrain: Bool
    ) -> None:
        self._points, self._limits, self._floor = Xyz(x, y, z), limits, floor
        self._labelled = _Labelled(
            np.full(x.size, -1, np.int32), np.zeros(x.size, np.bool_), terrain
        )
        self._tin: Tin | None = None

    def count(self, tin: Tin, uncertified: UInt8) -> tuple[int, int]:
        """Number of points that joined the terrain class, and number of points whose label is uncertified."""
        last = self._tin or tin
        self._tin = tin
        now = np.full(last.n_triangles, -1, np.int32)
        points, limits, floor = self._points, self._limits, self._floor
        mesh = CheckedMesh(*tin.mesh, uncertified)
        return _tally(last.mesh, mesh, points, limits, floor, now, self._labelled)


class Round(NamedTuple):
    """The TIN against which points are tested in a round.

    Attributes
    ----------
    tin : Tin
    uncertified : uint8 [triangles]
        Mask of uncertified triangles (`ptd.ground.certificates.UncertifiedRegion.triangles`).
    vertex : bool [n]
        Whether a point of the stacks is a vertex of the TIN.
    """

    tin: Tin
    uncertified: UInt8
    vertex: Bool


def densify_thinned(
    stacks: Stacks, seeds: Int32, virtual: Int32, limits: FacetLimits, region: UncertifiedRegion
) -> Iterator[Round]:
    """The TINs of successive rounds: first that of the seeds, then of the lowest terrain points per cell.

    The rounds end when the next TIN would be the same, here and beyond the window. A vertex
    stays until a lower point of its cell becomes one, and never returns. So the rounds in which
    points became vertices determine the vertices of each round.

    Parameters
    ----------
    stacks : Stacks
        All points that may become vertices, by the cells that keep one vertex.
    seeds : int32 [m]
        Indices into the stacks.
    virtual : int32 [k, 3]
        x, y, z of vertices that always stay.
    limits : FacetLimits
        Thresholds with which a point is terrain.
    region : UncertifiedRegion
        Uncertified region, to which the points are added whose becoming a vertex depends on points outside the
        window.

    Yields
    ------
    Round
    """
    points = Xyz(stacks.x, stacks.y, stacks.z)
    x, y = points.x, points.y
    vertex = np.zeros(x.size, np.bool_)
    vertex[seeds] = True
    uncertified_points = np.zeros(x.size, np.bool_)
    uncertified_points[seeds] = region.covers(x[seeds], y[seeds])
    while True:
        tin = tin_with_ring(points, vertex, virtual)
        uncertified = region.triangles(tin)
        yield Round(tin, uncertified, vertex)
        mesh = CheckedMesh(*tin.mesh, uncertified)
        kept = _test_stacks(mesh, points, stacks.starts, limits, vertex, uncertified_points)
        spread = region.add_points(x, y, uncertified_points)
        if not spread and np.array_equal(kept, vertex):
            return
        vertex = kept
