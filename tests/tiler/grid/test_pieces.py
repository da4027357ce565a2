"""Areas that were labelled in blocks and joined are those of the whole raster."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import ndimage

from tiler.grid.coarse import AROUND, Piece, join_pieces, label_block, touching_cells
from tiler.grid.tasks.steps import outside_of

SIDE = 4
"""Cells of a block."""


@pytest.fixture(autouse=True, scope="module")
def small_blocks() -> object:
    patch = pytest.MonkeyPatch()
    patch.setattr("tiler.grid.coarse.BLOCK_PIXELS", SIDE)
    patch.setattr("tiler.grid.tasks.steps.BLOCK_PIXELS", SIDE)
    yield
    patch.undo()


def rasters(rows: int = 3, cols: int = 4) -> st.SearchStrategy[np.ndarray]:
    """Rasters of so many blocks."""
    return arrays.arrays(np.bool_, (rows * SIDE, cols * SIDE))


def blocks(cells: np.ndarray) -> list[tuple[int, int]]:
    return [
        (r, c) for r in range(0, cells.shape[0], SIDE) for c in range(0, cells.shape[1], SIDE)
    ]


def part(cells: np.ndarray, place: tuple[int, int]) -> np.ndarray:
    row, col = place
    return cells[row : row + SIDE, col : col + SIDE]


@given(rasters(), st.booleans())
def test_joined_areas_are_those_of_the_whole(cells: np.ndarray, corners: bool) -> None:
    labelled = {place: label_block(part(cells, place), corners) for place in blocks(cells)}
    counts = {
        place: {"sides": sides, "labels": int(labels.max())}
        for place, (labels, sides) in labelled.items()
    }
    joined = join_pieces(counts, corners)
    found = np.zeros(cells.shape, int)
    for number, area in enumerate(joined.areas.values(), start=1):
        for piece in area:
            part(found, (piece.row, piece.col))[
                labelled[piece.row, piece.col][0] == piece.label
            ] = number
    whole, count = ndimage.label(cells, AROUND if corners else None)
    assert len(joined.areas) == count
    assert len(np.unique(np.stack((found[cells], whole[cells])), axis=1).T) == count
    for place in labelled:
        for piece, name in joined.joins([place]):
            assert piece in joined.areas[name]
            assert name == joined.areas[name][0]


@settings(max_examples=300)
@given(rasters(5, 6), st.lists(st.booleans(), min_size=30, max_size=30))
def test_what_is_enclosed_is_found_from_the_sides_of_blocks(
    cells: np.ndarray, kept: list[bool]
) -> None:
    """Cells are closed ones; blocks that are not kept hold none, and have no record."""
    closed = cells.copy()
    for place, keep in zip(blocks(closed), kept, strict=True):
        if not keep:
            part(closed, place)[:] = False
    labelled = {
        place: label_block(~part(closed, place), corners=False)
        for place, keep in zip(blocks(closed), kept, strict=True)
        if keep
    }
    outside, empty = outside_of({place: sides for place, (_, sides) in labelled.items()})
    found = np.zeros(closed.shape, bool)
    for place, (labels, _) in labelled.items():
        beyond = [piece.label for piece in outside.get(place, ())]
        part(found, place)[:] = (labels > 0) & ~np.isin(labels, beyond)
    for place in empty:
        assert place not in labelled
        part(found, place)[:] = True
    assert (found == (ndimage.binary_fill_holes(closed) & ~closed)).all()


def test_an_area_is_named_after_its_first_piece() -> None:
    cells = np.zeros((SIDE, 2 * SIDE), bool)
    cells[1] = True
    counts = {
        place: {"sides": label_block(part(cells, place), corners=False)[1], "labels": 1}
        for place in blocks(cells)
    }
    (area,) = join_pieces(counts, corners=False).areas.items()
    assert area == (Piece(0, 0, 1), (Piece(0, 0, 1), Piece(0, SIDE, 1)))


@given(rasters(), st.randoms(use_true_random=False))
def test_touching_cells_are_in_one_group_in_their_order(cells: np.ndarray, random: Any) -> None:
    listed = [(row, col) for row, col in np.argwhere(cells).tolist()]
    random.shuffle(listed)
    labels, n_areas = ndimage.label(cells, AROUND)
    groups = touching_cells(listed)
    assert len(groups) == n_areas
    assert [group[0] for group in groups] == sorted((g[0] for g in groups), key=listed.index)
    for group in groups:
        label = labels[group[0]]
        assert group == [place for place in listed if labels[place] == label]
