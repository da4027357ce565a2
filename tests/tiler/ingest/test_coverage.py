"""Points that another survey covers: by distances between all cells, and for any cut into buckets and files."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from tiler.core.lattice import Cell, CoordFrame, Lattice
from tiler.core.points import (
    HIGH_NOISE,
    STRAY_FLAG,
    UNSELECTED_FLAG,
    WITHHELD_FLAG,
    PointBlock,
    pack_origin,
)
from tiler.core.surveys import (
    GAP_M,
    MIN_WIDTH_M,
    NEAR_M,
    REACH_M,
    SEAM_M,
    CellMask,
    survey_cells_of,
)
from tiler.core.units import Units
from tiler.ingest.coverage import Outranked, covered, flag_outranked
from tiler.ingest.surveys import SurveyCells, surveys_in

METRES = CoordFrame(origin=(500_000_000, 5_400_000_000))
FEET = CoordFrame(
    Units(Fraction(1200, 3937), Fraction(1200, 3937)), origin=(500_000_000, 5_400_000_000)
)


def points(xy_m: np.ndarray, source: int, frame: CoordFrame = METRES) -> PointBlock:
    counts = np.rint(xy_m.T / float(frame.metres_xy)).astype(np.int32)
    n = counts.shape[1]
    return PointBlock(
        np.vstack([counts, np.zeros(n, np.int32)]),
        classification=np.ones(n, np.uint8),
        flags=np.zeros(n, np.uint8),
        returns=np.ones((2, n), np.uint8),
        origin=pack_origin(source, np.arange(n)),
    )


def in_buckets(block: PointBlock, side_m: int, frame: CoordFrame) -> dict[Cell, PointBlock]:
    lattice = Lattice(frame.counts(Fraction(side_m)))
    cells = [
        lattice.index(block.xyz[axis].astype(np.int64) + frame.origin[axis]) for axis in (0, 1)
    ]
    return {
        Cell(int(ix), int(iy)): block.take((cells[0] == ix) & (cells[1] == iy))
        for ix, iy in set(zip(*(c.tolist() for c in cells), strict=True))
    }


def hidden(
    block: PointBlock, surveys: list[tuple[int, ...]], side_m: int, frame: CoordFrame
) -> set[tuple[int, int]]:
    """Position of each point that does not count, with the work of the tasks done bucket by bucket."""
    lattice = Lattice(frame.counts(Fraction(side_m)))
    buckets = in_buckets(block, side_m, frame)
    found: dict[Cell, SurveyCells] = {
        cell: surveys_in(bucket, (cell.ix, cell.iy), surveys, frame)
        for cell, bucket in buckets.items()
    }
    positions = set()
    cells = survey_cells_of(frame)
    whole = (*(cells.index_of(origin) - 60 for origin in frame.origin), 240, 240)
    for cell, bucket in buckets.items():
        reach = math.ceil(frame.counts(Fraction(REACH_M)))
        near = list(lattice.among(lattice.bounds(cell).pad(reach), found))
        above = (
            (sources, CellMask.united((m for c in near for m in found[c].masks[:rank]), *whole))
            for rank, sources in enumerate(surveys)
        )
        outranked = tuple(Outranked(sources, mask) for sources, mask in above if mask)
        flagged, _ = flag_outranked(bucket, outranked, frame)
        assert flagged.flags is not None
        x, y, _ = flagged.xyz[:, (flagged.flags & UNSELECTED_FLAG) > 0]
        positions |= set(zip(x.tolist(), y.tolist(), strict=True))
    return positions


@pytest.mark.parametrize("seed", range(4))
def test_covered_cells_are_those_of_the_definition(seed: int) -> None:
    """Distances between all pairs of cells: disks close gaps and take what is narrow, the seam is added."""
    rng = np.random.default_rng(seed)
    size = 70
    cells = rng.random((size, size)) < (0.01, 0.03, 0.1, 0.5)[seed]
    cells[:, 35:] = False
    rows, columns = np.indices((size, size))
    positions = np.column_stack([rows.ravel(), columns.ravel()]) * 2.0

    def nearest(mask: np.ndarray) -> np.ndarray:
        some = positions[mask.ravel()]
        apart = np.hypot(*(positions[:, None, :] - some[None, :, :]).transpose(2, 0, 1))
        return apart.min(axis=1, initial=np.inf).reshape(size, size)

    def closed(mask: np.ndarray, gap: float) -> np.ndarray:
        return nearest(nearest(mask) > gap / 2) > gap / 2

    places = closed(cells, NEAR_M)
    wide = nearest(nearest(~places) > MIN_WIDTH_M / 2) <= MIN_WIDTH_M / 2
    expected = nearest(closed(wide, GAP_M)) <= SEAM_M
    # The disk of a cell at the edge of the square has no cells beyond it.
    core = slice(22, size - 22)
    masks = [
        CellMask.packed(0, 0, cells[:20]),
        CellMask.packed(0, 20, cells[20:, :30]),
        CellMask.packed(30, 20, cells[20:, 30:]),
    ]
    mask = CellMask.united(masks, 0, 0, size, size)
    assert mask is not None
    found = covered(mask, 22, 22, size - 44, size - 44)
    np.testing.assert_array_equal(found, expected[core, core])


@pytest.mark.parametrize("frame", [METRES, FEET], ids=["metres", "feet"])
def test_flags_depend_on_neither_buckets_nor_files_nor_order(frame: CoordFrame) -> None:
    rng = np.random.default_rng(7)
    areas = [(60, 20, 130, 90), (0, 0, 100, 100), (20, 40, 160, 140)]
    clouds = [rng.uniform(area[:2], area[2:], (2500, 2)) for area in areas]
    clouds[0] = clouds[0][np.hypot(*(clouds[0] - (95, 55)).T) > 18]  # A void of the newest one.
    one = PointBlock.concatenate([points(xy, n, frame) for n, xy in enumerate(clouds)])
    expected = hidden(one, [(0,), (1,), (2,)], 64, frame)
    # The middle of the void is not covered, the rest of the survey is.
    middle = {
        tuple(position)
        for position in np.rint(clouds[1] / float(frame.metres_xy)).astype(int).tolist()
        if np.hypot(*(np.array(position) * float(frame.metres_xy) - (95, 55))) < 8
    }
    assert middle
    assert not middle & expected
    for side_m in (8, 16, 128):
        assert hidden(one, [(0,), (1,), (2,)], side_m, frame) == expected
    # Each survey in two files, all points in another order, other numbers of the files.
    blocks = [
        points(part, 2 * n + half, frame)
        for n, xy in zip((2, 0, 1), clouds, strict=True)
        for half, part in enumerate((xy[xy[:, 0] < 70], xy[xy[:, 0] >= 70]))
    ]
    other = PointBlock.concatenate(blocks[::-1])
    other = other.take(rng.permutation(len(other)))
    assert hidden(other, [(4, 5), (0, 1), (2, 3)], 32, frame) == expected


@pytest.mark.parametrize(("gap_m", "closed"), [(18, True), (30, False)])
def test_a_narrow_gap_is_closed_and_a_wide_one_is_not(gap_m: int, closed: bool) -> None:
    grid = np.stack(np.meshgrid(np.arange(0.5, 160), np.arange(0.5, 60)), axis=-1).reshape(
        -1, 2
    )
    new = grid[(grid[:, 0] < 70) | (grid[:, 0] >= 70 + gap_m)]
    middle = 70 + gap_m / 2
    old = np.array([[middle, 30.0], [72.0, 30.0], [30.0, 30.0]])
    block = PointBlock.concatenate([points(new, 0), points(old, 1)])
    found = {x for x, _ in hidden(block, [(0,), (1,)], 32, METRES)}
    assert (round(middle * 1000) in found) == closed
    assert {72_000, 30_000} <= found  # The seam, and the inside.


SQUARE = np.stack(np.meshgrid(np.arange(20.5, 40), np.arange(20.5, 40)), axis=-1).reshape(-1, 2)
"""A point per square metre of 20 m."""


@pytest.mark.parametrize(
    ("change", "covers"),
    [
        ({"flags": 0}, True),
        ({"flags": UNSELECTED_FLAG}, True),
        ({"flags": WITHHELD_FLAG}, False),
        ({"flags": STRAY_FLAG}, False),
        ({"classification": HIGH_NOISE}, False),
    ],
    ids=str,
)
def test_points_cover_unless_they_are_withheld_or_noise(
    change: dict[str, int], covers: bool
) -> None:
    new, old = points(SQUARE, 0), points(np.full((1, 2), 30.1), 1)
    values = {name: np.full(len(new), value, np.uint8) for name, value in change.items()}
    block = PointBlock.concatenate([replace(new, **values), old])
    assert ((30_100, 30_100) in hidden(block, [(0,), (1,)], 32, METRES)) == covers


def test_points_by_themselves_hide_nothing() -> None:
    """Noise of a survey beyond its border, or in its voids, is seen as noise beside points of another one."""
    rng = np.random.default_rng(2)
    new = np.concatenate([SQUARE, rng.uniform(70, 150, (12, 2)), [[100.0, 40.0]]])
    old = rng.uniform(60, 160, (3000, 2))
    block = PointBlock.concatenate([points(new, 0), points(old, 1)])
    assert not hidden(block, [(0,), (1,)], 64, METRES)


def test_the_difference_is_that_of_flat_cells_alone() -> None:
    """Bins by the definition, from points in lists by cell."""
    rng = np.random.default_rng(3)
    blocks = []
    for source, lift in ((0, 0), (1, -250)):
        block = points(rng.uniform(0, 40, (4000, 2)), source)
        z = 100_000 + lift + rng.normal(0, 20, len(block))
        z[block.xyz[0] < 10_000] += rng.uniform(0, 2000, int((block.xyz[0] < 10_000).sum()))
        blocks.append(
            replace(block, xyz=np.vstack([block.xyz[:2], np.rint(z).astype(np.int32)]))
        )
    heights: list[dict[tuple[int, int], list[int]]] = []
    for block in blocks:
        by_cell = defaultdict(list)
        for x, y, z in block.xyz.T.tolist():
            by_cell[x // 2000, y // 2000].append(z)
        heights.append({c: v for c, v in by_cell.items() if len(v) > 2 and np.std(v) < 150})
    both = heights[0].keys() & heights[1].keys()
    bins = [round((np.mean(heights[1][c]) - np.mean(heights[0][c])) / 10) for c in both]
    assert len(both) > 200
    assert all(ix >= 5 for ix, _ in both)
    found = surveys_in(PointBlock.concatenate(blocks), (0, 0), [(0,), (1,)], METRES)
    ((i, j, values, numbers),) = found.differences
    assert (i, j, dict(zip(values, numbers, strict=True))) == (
        0,
        1,
        {value: bins.count(value) for value in sorted(set(bins))},
    )
