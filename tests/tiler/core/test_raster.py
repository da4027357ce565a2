"""Blocks of a raster: each pixel once, and those within bounds found without a look at the others."""

from __future__ import annotations

from fractions import Fraction

import pytest

from tiler.core.lattice import Bounds, Lattice
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
    overlapping = [b for b in SPEC.blocks(16) if not bounds.empty and SPEC.block_bounds(b).overlaps(bounds)]
    assert list(SPEC.blocks_within(bounds, 16)) == overlapping


def test_blocks_cover_each_pixel_once() -> None:
    pixels = [
        (row, col)
        for block in SPEC.blocks(16)
        for row in range(block.row, block.row + block.height)
        for col in range(block.col, block.col + block.width)
    ]
    assert sorted(pixels) == [(row, col) for row in range(SPEC.height) for col in range(SPEC.width)]
