"""Blocks of a raster cover each pixel once, and blocks near some place are found quickly."""

from __future__ import annotations

from fractions import Fraction

import pytest

from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.raster import RasterSpec

SPEC = RasterSpec(Lattice(Fraction(1000, 3)), -7, 11, 50, 33)


@pytest.mark.parametrize(
    "bounds",
    [
        SPEC.block_bounds(next(SPEC.blocks(100))),
        Bounds(0, 0, 1, 1),
        Bounds(333, -334, 334, -333),
        Bounds(-(10**6), -(10**6), 10**6, 10**6),
        Bounds(10**6, 0, 10**6 + 5, 5),
        Bounds(-3000, -9000, 2500, 2500),
        Bounds(5, 5, 5, 9),
    ],
)
def test_blocks_within_bounds_are_those_that_overlap_them(bounds: Bounds) -> None:
    overlapping = [
        b for b in SPEC.blocks(16) if not bounds.empty and SPEC.block_bounds(b).overlaps(bounds)
    ]
    assert list(SPEC.blocks_within(bounds, 16)) == overlapping


def test_blocks_cover_each_pixel_once() -> None:
    pixels = [
        (row, col)
        for block in SPEC.blocks(16)
        for row in range(block.row, block.row + block.height)
        for col in range(block.col, block.col + block.width)
    ]
    assert sorted(pixels) == [
        (row, col) for row in range(SPEC.height) for col in range(SPEC.width)
    ]


@pytest.mark.parametrize("reach", [0, 1, 700])
def test_blocks_near_cells_have_the_cells_that_reach_them(reach: int) -> None:
    lattice = Lattice(Fraction(500))
    cells = {Cell(ix, iy) for ix in range(-6, 9, 2) for iy in range(-12, 10, 3)}
    expected = {}
    for block in SPEC.blocks(16):
        near = lattice.among(SPEC.block_bounds(block).pad(reach), cells)
        if near:
            expected[block] = near
    found = SPEC.blocks_near(lattice, cells, 16, reach)
    assert found == expected
    assert list(found) == list(expected)


def test_blocks_near_a_few_cells_of_a_huge_raster_are_found_at_once() -> None:
    wide = RasterSpec(Lattice(Fraction(1000)), 0, 4_000_000, 4_000_000, 4_000_000)
    cells = [Cell(0, 0), Cell(31_249, 31_249)]
    assert [b.name for b in wide.blocks_near(Lattice(Fraction(128_000)), cells, 512)] == [
        "r0000000c3999744",
        "r3999744c0000000",
    ]


def test_a_block_is_found_by_its_name() -> None:
    for block in SPEC.blocks(16):
        assert SPEC.block_named(block.name, 16) == block


@pytest.mark.parametrize(
    ("size", "last", "pixels"),
    [
        (Fraction(1000), 50_000, 50),  # on the edge of the last pixel
        (Fraction(1000), 50_001, 51),
        (Fraction(1000), 49_999, 50),
        (Fraction(1000), 0, 1),  # the only pixel
        (Fraction(1000, 3), 50_000, 150),
        (Fraction(1000, 3), 50_001, 151),
        (Fraction(1000, 3), 333, 1),  # the edge is a third of a count farther
        (Fraction(1000, 3), 334, 2),
    ],
)
def test_points_on_the_outer_edge_alone_make_no_pixel(
    size: Fraction, last: int, pixels: int
) -> None:
    extent = Bounds(0, -last, last + 1, 1)
    spec = RasterSpec.enclosing(Lattice(size), extent)
    assert (spec.west, spec.width) == (0, pixels)
    south = Lattice(size).index_of(-last)  # the lower and left edge belong to a pixel
    assert (spec.north, spec.north - spec.height) == (max(0, south + 1), south)
