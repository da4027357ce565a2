"""Blocks of the steps that find the extent of the survey."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from itertools import chain, pairwise, product
from typing import Any, NamedTuple

from tiler.core.raster import BLOCK_PIXELS, Block, RasterSpec, north_west
from tiler.grid.coarse import Piece, Side, blocks_of, components, touching
from tiler.grid.tasks.gridding import GridContext, Place


class MissingRun(NamedTuple):
    """Run of missing blocks in a row of blocks, between two existing blocks.

    Attributes
    ----------
    kind : str
        ``gap``, or ``outside`` for the area around all blocks.
    row : int
        Row of the missing blocks (see `Place`).
    first, last : int
        Columns of the first and of the last missing block.
    """

    kind: str
    row: int
    first: int
    last: int


BEYOND_ALL = MissingRun("outside", 0, 0, 0)
"""Area around all blocks."""
SIDES = {"north": (-1, 0), "south": (1, 0), "west": (0, -1), "east": (0, 1)}
"""Offset of the neighbour at each side of a block: blocks down, and blocks to the right."""


def near_places(coarse: RasterSpec, places: Iterable[Place], n_blocks: int = 1) -> list[Place]:
    """Return the places of blocks, and of other blocks up to ``n_blocks`` away, from the north-west.

    Places outside the raster are left out.
    """
    offsets = [step * BLOCK_PIXELS for step in range(-n_blocks, n_blocks + 1)]
    near: set[Place] = set()
    for row, col in places:
        near.update((row + down, col + right) for down, right in product(offsets, offsets))
    return sorted(
        (row, col) for row, col in near if 0 <= row < coarse.height and 0 <= col < coarse.width
    )


def block_names(places: Iterable[Place]) -> list[str]:
    """Return the names of the blocks at some places."""
    return [Block(*place, 0, 0).name for place in places]


def near_points(context: GridContext, occupancy: str, n_blocks: int) -> Iterator[Block]:
    """Yield the blocks of coarse cells up to ``n_blocks`` away from one with points."""
    coarse = context.coarse
    occupied = [
        (block.row, block.col)
        for block, counts in context.counts(occupancy).items()
        if counts["filled"]
    ]
    for place in near_places(coarse, occupied, n_blocks):
        yield coarse.block_at(*place, BLOCK_PIXELS)


def enclosed_by(context: GridContext, opened: str) -> dict[Block, dict[str, Any]]:
    """Return the blocks of open areas, and the missing blocks that the survey encloses, with the values of `survey`."""
    coarse = context.coarse
    found = context.counts(opened)
    sides = {(block.row, block.col): counts["sides"] for block, counts in found.items()}
    outside, empty = outside_of(sides)
    values = {}
    for place in {*sides, *empty}:
        near = near_places(coarse, [place])
        values[coarse.block_at(*place, BLOCK_PIXELS)] = {
            "outside": list(chain.from_iterable(outside.get(other, ()) for other in near)),
            "empty": [other for other in near if other in empty],
        }
    return values


def outside_of(
    blocks: Mapping[Place, Mapping[str, Side]],
) -> tuple[dict[Place, list[Piece]], set[Place]]:
    """Find the open areas that are connected with the outside of a survey, and the missing blocks that it encloses.

    Parameters
    ----------
    blocks : mapping
        For the place of each existing block, the labels of the open areas along its sides. A missing block is
        completely open.

    Returns
    -------
    outside : dict
        For the place of a block, its open areas that are connected with the outside.
    enclosed : set
        Places of the missing blocks that the survey encloses.
    """
    columns: dict[int, list[int]] = defaultdict(list)
    for row, col in sorted(blocks):
        columns[row].append(col)
    gaps = {row: _missing_runs(row, cols) for row, cols in columns.items()}
    pairs: list[tuple[Any, Any]] = [*touching(blocks, corners=False)]
    for (row, col), sides in blocks.items():
        for side, (down, right) in SIDES.items():
            neighbour = (row + down * BLOCK_PIXELS, col + right * BLOCK_PIXELS)
            if neighbour not in blocks:
                gap = _missing_run_at(gaps, *neighbour)
                pairs += [(Piece(row, col, label), gap) for label in _labels(sides[side])]
    all_gaps = list(chain.from_iterable(gaps.values()))
    for gap in all_gaps:
        for row in (gap.row - BLOCK_PIXELS, gap.row + BLOCK_PIXELS):
            pairs += [(gap, other) for other in _facing(gap, row, gaps, columns)]
    nodes = dict.fromkeys((*chain.from_iterable(pairs), BEYOND_ALL))
    beyond = next(set(group) for group in components(nodes, pairs) if BEYOND_ALL in group)
    outside: dict[Place, list[Piece]] = defaultdict(list)
    for piece in sorted(node for node in beyond if isinstance(node, Piece)):
        outside[piece.row, piece.col].append(piece)
    enclosed: set[Place] = set()
    for gap in all_gaps:
        if gap not in beyond:
            enclosed.update(
                (gap.row, col) for col in range(gap.first, gap.last + 1, BLOCK_PIXELS)
            )
    return outside, enclosed


def _labels(side: Side) -> list[int]:
    """Return the labels of the areas along a side."""
    return sorted({label for label, _ in side if label})


def _missing_runs(row: int, cols: list[int]) -> list[MissingRun]:
    """Return the gaps between the blocks of a row."""
    gaps = []
    for col, next_col in pairwise(cols):
        if next_col - col > BLOCK_PIXELS:
            gaps.append(MissingRun("gap", row, col + BLOCK_PIXELS, next_col - BLOCK_PIXELS))
    return gaps


def _missing_run_at(gaps: Mapping[int, list[MissingRun]], row: int, col: int) -> MissingRun:
    """Return the gap at a place without a block, or `BEYOND_ALL`."""
    return next((gap for gap in gaps.get(row, ()) if gap.first <= col <= gap.last), BEYOND_ALL)


def _facing(
    gap: MissingRun,
    row: int,
    gaps: Mapping[int, list[MissingRun]],
    columns: Mapping[int, list[int]],
) -> list[MissingRun]:
    """Return the gaps of an adjacent row of blocks that touch a gap.

    `BEYOND_ALL` is one of them if the gap extends beyond the first or last block of that row, or if the row is missing.
    """
    touching_gaps = []
    for other in gaps.get(row, ()):
        if other.first <= gap.last and gap.first <= other.last:
            touching_gaps.append(other)
    cols = columns.get(row)
    if cols is None or gap.first < cols[0] or gap.last > cols[-1]:
        touching_gaps.append(BEYOND_ALL)
    return touching_gaps


def surveyed_blocks(context: GridContext, survey: str) -> list[Block]:
    """Return the blocks of the products that overlap the inside of the survey, from the north-west."""
    found = context.counts(survey).values()
    runs = list(chain.from_iterable(counts["blocks"] for counts in found))
    return sorted(set(blocks_of(runs, context.spec, BLOCK_PIXELS)), key=north_west)
