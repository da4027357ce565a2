"""Progressive densification: the seeds of the first TIN, then rounds that insert candidates in batches.

Seeds are the lowest point per cell, and a ring of virtual points that continues the TIN beyond
the data. Every round tests the candidates against one TIN, then inserts all that pass. So its
result depends only on the set of candidates, not on their order (Chen 2023, 2.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ptd.arrays import Bool, Int32, UInt8
from ptd.cells import Xyz, lowest_per_cell
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.certificates import CheckedMesh, UncertifiedRegion
from ptd.ground.criteria import FacetLimits, accepts
from ptd.kernel import as_int64, kernel
from ptd.tin.insertion import insert
from ptd.tin.mesh import Tin
from ptd.tin.triangles import STAMP, Mesh, is_ghost, locate

RING = 2
"""Width in cells of the ring of virtual seeds around occupied cells. A circle through or around
a data point with a radius above sqrt(2) cells would contain a whole cell within two cells of
the point, and so a seed. So an empty circle (one without vertices) has a radius of at most
sqrt(2) cells and extends less than three cells from the data."""


@dataclass(frozen=True)
class Seeds:
    """Vertices of the first TIN: the chosen points and the virtual ones.

    Attributes
    ----------
    chosen : int32 [m]
        Indices of the points that are seeds.
    virtual : int32 [k, 3]
        x, y, z of the virtual seeds in local counts; they are never output.
    """

    chosen: Int32
    virtual: Int32


def choose_seeds(
    x: Int32,
    y: Int32,
    z: Int32,
    eligible: Bool,
    cells: CellLattice,
    region: UncertifiedRegion,
    uncertified: Bool | None = None,
) -> Seeds:
    """Choose the lowest eligible point per cell of a lattice anchored at CRS coordinate 0, and the ring around them.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts. At least one point is eligible.
    eligible : bool [n]
        Mask of the points that may be seeds.
    cells : CellLattice
        Lattice of the seed cells.
    region : UncertifiedRegion
        Uncertified region, to which cells with an uncertified seed are added.
    uncertified : bool [n], optional
        Mask of the points for which ``eligible`` is uncertified; none by default.
    """
    index = np.flatnonzero(eligible).astype(np.int32)
    chosen = index[lowest_per_cell(x[index], y[index], z[index], cells)]
    filled = cells_of(x[chosen], y[chosen], cells)
    heights = {cell: int(h) for cell, h in zip(filled, z[chosen], strict=True)}
    virtual = _ring(heights)
    if region.active and uncertified is None:
        _add_uncertified_cells(set(filled), set(), cells, region)
    elif region.active and uncertified is not None:
        certain = eligible & ~uncertified
        certified_cells, uncertified_cells = (
            set(cells_of(x[w], y[w], cells)) for w in (certain, uncertified)
        )
        _add_uncertified_cells(certified_cells, uncertified_cells, cells, region)
    half = cells.p // (2 * cells.q)
    points = [
        (cells.west(c) + half, cells.south(r) + half, h)
        for (c, r), h in sorted(virtual.items())
    ]
    return Seeds(chosen, np.array(points, np.int32).reshape(-1, 3))


def cells_of(x: Int32, y: Int32, cells: CellLattice) -> list[tuple[int, int]]:
    """Return column and row of each point."""
    columns, rows = cells.cell_indices(x, y)
    return list(zip(columns.tolist(), rows.tolist(), strict=True))


def _neighbours(cell: tuple[int, int], reach: int = 1) -> list[tuple[int, int]]:
    c, r = cell
    span = range(-reach, reach + 1)
    return [(c + i, r + j) for j in span for i in span if i or j]


def _ring(heights: dict[tuple[int, int], int]) -> dict[tuple[int, int], int]:
    """Return heights of the empty cells around filled ones, layer by layer outward (Chen 2023, 2.2).

    The height of a cell is the mean of its filled 8-neighbours.
    """
    filled = dict(heights)
    added: dict[tuple[int, int], int] = {}
    rim = set(heights)
    for _ in range(RING):
        empty = {n for cell in rim for n in _neighbours(cell) if n not in filled}
        layer = {}
        for cell in empty:
            around = [filled[n] for n in _neighbours(cell) if n in filled]
            layer[cell] = sum(around) // len(around)
        filled.update(layer)
        added.update(layer)
        rim = empty
    return added


def _add_uncertified_cells(
    filled: set[tuple[int, int]],
    uncertified: set[tuple[int, int]],
    cells: CellLattice,
    region: UncertifiedRegion,
) -> None:
    """Make the cells uncertified that may have another seed in the untiled run.

    These are cells that are not wholly known, and empty cells within the ring around them. A
    point beyond the border could add or remove the virtual seed of an empty cell near it, or
    change its height. The same applies to cells near cells with points of uncertified
    eligibility (`uncertified`). Cells of `filled` contain a point that is certainly eligible.
    """
    known, deep = region.known.inside(cells), region.known.inside(cells, RING)
    reached = uncertified.union(*(_neighbours(cell, RING) for cell in uncertified))
    west, south, east, north = region.box
    for row in range(cells.row(south), cells.row(north - 1) + 1):
        for column in range(cells.column(west), cells.column(east - 1) + 1):
            box = (
                cells.west(column),
                cells.south(row),
                cells.west(column + 1),
                cells.south(row + 1),
            )
            if known.contains_box(*box) and (column, row) in filled:
                continue
            if not deep.contains_box(*box) or (column, row) in reached:
                region.add_box(*box)


def tin_with_ring(points: Xyz, chosen: Bool | Int32, ring: Int32, max_vertices: int = 1) -> Tin:
    """Triangulate the points that a mask or an index chooses, and the virtual seeds around them.

    ``max_vertices`` is the room for later insertions (`ptd.tin.mesh.Tin.build`).
    """
    columns = (np.concatenate([c[chosen], v]) for c, v in zip(points, ring.T, strict=True))
    return Tin.build(*columns, max_vertices=max_vertices)


def box_with_ring(x: Int32, y: Int32, cells: CellLattice) -> tuple[int, int, int, int]:
    """Return west, south, east and north of a box that contains all empty circles through or around data (`RING`).

    They are local counts.
    """
    c0, c1 = cells.column(int(x.min())), cells.column(int(x.max()))
    r0, r1 = cells.row(int(y.min())), cells.row(int(y.max()))
    margin = RING + 1
    return (
        cells.west(c0 - margin),
        cells.south(r0 - margin),
        cells.west(c1 + margin + 1),
        cells.south(r1 + margin + 1),
    )


WAITING, VERTEX, REFUSED = 0, 1, 2
"""States of a candidate: to be tested, in the TIN, never to be tested (such as an outlier or a
roof)."""


class _Candidates(NamedTuple):
    """State of each candidate between rounds.

    Attributes
    ----------
    state : uint8 [n]
        `WAITING`, `VERTEX` or `REFUSED`.
    home : int32 [n]
        Triangle of the last test; -1 before the first one.
    again : bool [n]
        Whether the last result depended on other triangles as well.
    uncertified_points : bool [n]
        Whether points outside the window could change a decision.
    """

    state: UInt8
    home: Int32
    again: Bool
    uncertified_points: Bool


@kernel
def _test_round(
    mesh: CheckedMesh,
    points: Xyz,
    candidates: _Candidates,
    limits: FacetLimits,
    stamp: int,
    chosen: Int32,
) -> int:
    """Test the candidates whose triangle changed since their last test, and return the number of those that pass.

    `chosen` gets the indices of those that pass. Triangles that the last round changed have the stamp ``stamp - 1``. A
    candidate whose result depends on other triangles as well (mirrored, or on an edge) is tested in every round
    (`again`).
    """
    vertices, triangles, uncertified = mesh
    x, y, z = points
    state, home, again, uncertified_points = candidates
    n_chosen = 0
    t = as_int64(0)
    for i in range(x.size):
        if state[i] != 0:
            continue
        if home[i] >= 0:
            t = as_int64(home[i])
        if home[i] >= 0 and not again[i] and triangles[8 * t + STAMP] < stamp - 1:
            uncertified_points[i] = uncertified_points[i] or uncertified[t] != 0
            continue
        px, py, pz = as_int64(x[i]), as_int64(y[i]), as_int64(z[i])
        t = locate(vertices, triangles, px, py, t)
        home[i] = t
        if is_ghost(triangles, t):
            uncertified_points[i] = uncertified_points[i] or uncertified[t] != 0
            continue
        passed, elsewhere, is_uncertified = accepts(
            vertices, triangles, uncertified, t, (px, py, pz), limits
        )
        again[i] = elsewhere
        uncertified_points[i] = uncertified_points[i] or is_uncertified
        if passed:
            chosen[n_chosen] = i
            n_chosen += 1
    return n_chosen


@kernel
def _insert_points(
    mesh: Mesh, counters: Int32, points: Xyz, home: Int32, chosen: Int32, stamp: int
) -> None:
    """Insert the chosen points. `home` contains a triangle near each of them, or -1."""
    vertices, triangles = mesh
    x, y, z = points
    hint = as_int64(0)
    for k in range(chosen.size):
        i = chosen[k]
        if home[i] >= 0:
            hint = as_int64(home[i])
        v = insert(
            vertices,
            triangles,
            counters,
            as_int64(x[i]),
            as_int64(y[i]),
            as_int64(z[i]),
            hint,
            stamp,
        )
        hint = as_int64(max(vertices[4 * v + 3], 0))


def densify(
    tin: Tin,
    points: Xyz,
    state: UInt8,
    limits: FacetLimits,
    rounds: int,
    region: UncertifiedRegion,
) -> tuple[Bool, int]:
    """Densify a TIN in rounds until no candidate passes any more, or for `rounds` rounds.

    The rounds continue while the uncertified region grows, even if no candidate passes, because
    outside the window candidates may still pass.

    Parameters
    ----------
    tin : Tin
        TIN of the seeds with stamp 0 in each triangle and space for all candidates; densified in place.
    points : Xyz
        Candidates, in an order in which neighbours are near each other.
    state : uint8 [n]
        State of each candidate: `WAITING`, `VERTEX` or `REFUSED`; updated.
    limits : FacetLimits
    rounds : int
        Largest number of rounds; 0: until no candidate passes.
    region : UncertifiedRegion
        Uncertified region. Candidates are added to it if points outside the window could change their results.

    Returns
    -------
    uncertified_points : bool [n]
        Mask of the candidates whose results could be changed by points outside the window.
    rounds : int
        Number of rounds that were run.
    """
    n_points = points.x.size
    home, room = np.full(n_points, -1, np.int32), np.empty(n_points, np.int32)
    uncertified_points = np.zeros(n_points, np.bool_)
    candidates = _Candidates(state, home, np.zeros(n_points, np.bool_), uncertified_points)
    stamp = 0
    while rounds == 0 or stamp < rounds:
        stamp += 1
        mesh = CheckedMesh(*tin.mesh, region.triangles(tin))
        n = _test_round(mesh, points, candidates, limits, stamp, room)
        spread = region.add_points(points.x, points.y, uncertified_points)
        if n == 0 and not spread:
            break
        chosen = room[:n]
        state[chosen] = VERTEX
        _insert_points(tin.mesh, tin.counters, points, home, chosen, stamp)
    return uncertified_points, stamp


def densify_seeds(
    points: Xyz,
    outlier: Bool,
    seed_cells: CellLattice,
    limits: FacetLimits,
    rounds: int,
    known: Window,
    scale: Scale,
) -> tuple[Tin, UInt8, int]:
    """Densify the TIN of the lowest points per seed cell and their ring (`ptd.ground.densify`).

    Parameters
    ----------
    points : Xyz
        Candidates, in an order in which neighbours are near each other. At least one is not an outlier.
    outlier : bool [n]
        Mask of outliers, which become neither seeds nor vertices.
    seed_cells : CellLattice
    limits : FacetLimits
    rounds : int
        Largest number of rounds (`densify`).
    known : Window
        Window in which all candidates and the mask of outliers are known.
    scale : Scale

    Returns
    -------
    tin : Tin
    uncertified : uint8 [triangles]
        Mask of uncertified triangles (`ptd.ground.certificates.UncertifiedRegion.triangles`).
    rounds : int
        Number of rounds that were run.
    """
    x, y, z = points
    region = UncertifiedRegion(
        known, known.inside(seed_cells, RING), box_with_ring(x, y, seed_cells), scale
    )
    seeds = choose_seeds(x, y, z, ~outlier, seed_cells, region)
    state = np.where(outlier, np.uint8(REFUSED), np.uint8(WAITING)).astype(np.uint8)
    state[seeds.chosen] = VERTEX
    tin = tin_with_ring(points, seeds.chosen, seeds.virtual, x.size + len(seeds.virtual))
    _, run = densify(tin, points, state, limits, rounds, region)
    return tin, region.triangles(tin), run
