"""Coarse cells, in blocks that are anchored at CRS coordinate 0: their connected areas, and what is near them.

Decisions on coarse cells are made block by block, each with a margin of its neighbours. So the decision at a position
does not depend on what else is in the run.

A task labels the areas of its block and records the labels along the block's sides. The coordinator joins areas that
touch, so that an array of the whole raster is never needed.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
import scipy

from ptd.arrays import AnyArray, Bool, Float64, Floating, Int32
from tiler.core.lattice import Bounds, Lattice
from tiler.core.raster import BLOCK_PIXELS, Block, RasterSpec
from tiler.store import TileStore, read_cells

Runs = list[list[int]]
"""Runs of neighbouring blocks: first row of pixels, first columns of first and last block (see
`block_runs`)."""


def coarse_raster(lattice: Lattice, extent: Bounds) -> RasterSpec:
    """Return the smallest raster of whole blocks that contains an extent. Blocks are anchored at CRS coordinate 0."""
    size, tight = BLOCK_PIXELS, RasterSpec.covering(lattice, extent)
    west, south = tight.west // size * size, (tight.north - tight.height) // size * size
    east, north = -(-(tight.west + tight.width) // size) * size, -(-tight.north // size) * size
    return RasterSpec(lattice, west, north, north - south, east - west)


def padded(block: Block, pad: int) -> Block:
    """Return a block and ``pad`` cells around it, which may extend beyond the raster."""
    return Block(
        block.row - pad, block.col - pad, block.height + 2 * pad, block.width + 2 * pad
    )


def padded_within(block: Block, pad: int, spec: RasterSpec) -> Block:
    """Return a block and ``pad`` pixels around it, cut at the border of the raster."""
    top, left = max(block.row - pad, 0), max(block.col - pad, 0)
    bottom = min(block.row + block.height + pad, spec.height)
    right = min(block.col + block.width + pad, spec.width)
    return Block(top, left, bottom - top, right - left)


def pixels_touching(spec: RasterSpec, bounds: Bounds) -> Block:
    """Return the pixels that overlap bounds, which may lie beyond the raster."""
    cover = RasterSpec.covering(spec.lattice, bounds)
    return Block(spec.north - cover.north, cover.west - spec.west, cover.height, cover.width)


def block_runs(
    cells: Bool, coarse: RasterSpec, spec: RasterSpec, size: int, pad: int = 0
) -> Runs:
    """Find the blocks of a raster within ``pad`` pixels of a set coarse cell.

    Only the cells are visited, since a raster that is mostly empty has far more blocks.

    Parameters
    ----------
    cells : bool, shape (height, width) of ``coarse``
    coarse, spec : RasterSpec
        Rasters of the cells and of the blocks.
    size : int
        Side of a block in pixels.
    pad : int

    Returns
    -------
    list of [int, int, int]
        First row of pixels of each run of neighbouring blocks, and first columns of its first and last block.
    """
    rows: dict[int, list[tuple[int, int]]] = {}
    for row in np.flatnonzero(cells.any(axis=1)).tolist():
        steps = (
            np.flatnonzero(np.diff(cells[row], prepend=False, append=False))
            .reshape(-1, 2)
            .tolist()
        )
        for start, end in steps:
            box = covered(coarse, spec, Block(row, start, 1, end - start), pad)
            if box.height <= 0 or box.width <= 0:
                continue
            run = box.col // size * size, (box.col + box.width - 1) // size * size
            for top in range(box.row // size * size, box.row + box.height, size):
                rows.setdefault(top, []).append(run)
    return [
        [row, first, last] for row in sorted(rows) for first, last in _merged(rows[row], size)
    ]


def _merged(runs: list[tuple[int, int]], size: int) -> list[tuple[int, int]]:
    """Merge the runs of a row that overlap or touch, and return them from west to east."""
    merged_runs: list[tuple[int, int]] = []
    for first, last in sorted(set(runs)):
        if merged_runs and first <= merged_runs[-1][1] + size:
            merged_runs[-1] = merged_runs[-1][0], max(merged_runs[-1][1], last)
        else:
            merged_runs.append((first, last))
    return merged_runs


def blocks_of(runs: Runs, spec: RasterSpec, size: int) -> Iterator[Block]:
    """Yield the blocks that `block_runs` found, row by row from the north-west."""
    for row, first, last in runs:
        for col in range(first, last + 1, size):
            yield spec.block_at(row, col, size)


def covered(coarse: RasterSpec, spec: RasterSpec, cells: Block, pad: int = 0) -> Block:
    """Return the pixels of a raster that coarse cells touch, padded by ``pad`` within the raster."""
    return padded_within(pixels_touching(spec, coarse.block_bounds(cells)), pad, spec)


def blocks_under(
    coarse: RasterSpec, spec: RasterSpec, cells: Block, size: int
) -> Iterator[Block]:
    """Yield the blocks of ``size`` pixels of a raster that overlap coarse cells."""
    yield from spec.blocks_within(coarse.block_bounds(cells), size)


Node = TypeVar("Node")

Side = list[list[int]]
"""Runs of labels along a side of a block from the north or west, as [label (0: none), number of
cells]."""

AROUND = np.ones((3, 3), np.bool_)
"""Neighbourhood in which cells touch at sides and corners."""


class Piece(NamedTuple):
    """Area of one block: the block's first row and column, and the area's label in the block, from 1."""

    row: int
    col: int
    label: int


def label_block(cells: Bool, corners: bool) -> tuple[Int32, dict[str, Side]]:
    """Label the areas of a block.

    Parameters
    ----------
    cells : bool, shape (height, width)
    corners : bool
        Whether cells that touch at a corner belong together.

    Returns
    -------
    labels : int32, shape (height, width)
        Labels from 1; 0 for cells that are not set.
    sides : dict
        Labels along the ``north``, ``south``, ``west`` and ``east`` side, for `join_pieces`.
    """
    labels, _ = scipy.ndimage.label(cells, AROUND if corners else None)
    sides = {
        "north": labels[0],
        "south": labels[-1],
        "west": labels[:, 0],
        "east": labels[:, -1],
    }
    return labels.astype(np.int32), {name: _runs(line) for name, line in sides.items()}


def _runs(line: AnyArray) -> Side:
    starts = np.flatnonzero(np.diff(line, prepend=line[0] - 1))
    lengths = np.diff(starts, append=len(line))
    return [
        [int(label), int(length)] for label, length in zip(line[starts], lengths, strict=True)
    ]


def _side_labels(side: Side) -> Int32:
    """Return the label of each cell along a side of a block."""
    labels, lengths = np.array(side, np.int32).T
    return np.repeat(labels, lengths)


def touching(
    blocks: Mapping[tuple[int, int], Mapping[str, Side]], corners: bool
) -> set[tuple[Piece, Piece]]:
    """Return the pairs of areas of neighbouring blocks that touch.

    Parameters
    ----------
    blocks : mapping
        First row and column of each block -> its sides, see `label_block`.
    corners : bool
    """
    touching_pairs: set[tuple[Piece, Piece]] = set()
    for (row, col), sides in blocks.items():
        below, right = (row + BLOCK_PIXELS, col), (row, col + BLOCK_PIXELS)
        for other, side, facing_side in ((below, "south", "north"), (right, "east", "west")):
            if other in blocks:
                pairs = _facing(
                    _side_labels(sides[side]), _side_labels(blocks[other][facing_side]), corners
                )
                touching_pairs |= {(Piece(row, col, a), Piece(*other, b)) for a, b in pairs}
        for other, end, start in (
            ((row + BLOCK_PIXELS, col + BLOCK_PIXELS), -1, 0),
            ((row + BLOCK_PIXELS, col - BLOCK_PIXELS), 0, -1),
        ):
            if corners and other in blocks:
                a, b = sides["south"][end][0], blocks[other]["north"][start][0]
                touching_pairs |= {(Piece(row, col, a), Piece(*other, b))} if a and b else set()
    return touching_pairs


def _facing(mine: Int32, theirs: Int32, corners: bool) -> Iterable[tuple[int, int]]:
    """Return the pairs of labels that face each other across the border of two blocks."""
    lines = [(mine, theirs)]
    if corners:
        lines += [(mine[1:], theirs[:-1]), (mine[:-1], theirs[1:])]
    both = np.concatenate([np.stack(line, axis=1) for line in lines])
    return [(int(a), int(b)) for a, b in np.unique(both[(both > 0).all(axis=1)], axis=0)]


def components(nodes: Iterable[Node], pairs: Iterable[tuple[Node, Node]]) -> list[list[Node]]:
    """Return groups of connected nodes. Groups and their nodes are in the order of the nodes."""
    listed = list(nodes)
    node_index = {node: i for i, node in enumerate(listed)}
    # Each node points to an earlier node of its group, and the first one to itself. Workers wait while the command
    # runs this, and importing the graphs of scipy would take longer.
    earlier = list(range(len(listed)))

    def first(i: int) -> int:
        while earlier[i] != i:
            earlier[i] = earlier[earlier[i]]
            i = earlier[i]
        return i

    for a, b in pairs:
        low, high = sorted((first(node_index[a]), first(node_index[b])))
        earlier[high] = low
    groups: dict[int, list[Node]] = {}
    for i, node in enumerate(listed):
        groups.setdefault(first(i), []).append(node)
    return list(groups.values())


def touching_cells(cells: Iterable[tuple[int, int]]) -> list[list[tuple[int, int]]]:
    """Return groups of cells that touch, also at corners, in the order of the cells, given as row and column."""
    listed = dict.fromkeys(cells)
    pairs = (
        ((row, col), (row + down, col + right))
        for row, col in listed
        for down, right in ((0, 1), (1, -1), (1, 0), (1, 1))
        if (row + down, col + right) in listed
    )
    return components(listed, pairs)


@dataclass(frozen=True)
class Joined:
    """Connected areas of a raster.

    Attributes
    ----------
    areas : mapping of Piece to tuple of Piece
        First piece of each area, which names it -> all its pieces, in the order of rows and columns of blocks.
    """

    areas: Mapping[Piece, tuple[Piece, ...]]

    @cached_property
    def _joins(self) -> dict[tuple[int, int], list[tuple[Piece, Piece]]]:
        joins: dict[tuple[int, int], list[tuple[Piece, Piece]]] = defaultdict(list)
        for name, pieces in self.areas.items():
            for piece in pieces if len(pieces) > 1 else ():
                joins[piece.row, piece.col].append((piece, name))
        return joins

    def joins(self, places: Iterable[tuple[int, int]]) -> tuple[tuple[Piece, Piece], ...]:
        """Return the pieces of multi-piece areas in some blocks, each with the name of its area."""
        return tuple(join for place in places for join in self._joins.get(place, ()))


def join_pieces(blocks: Mapping[tuple[int, int], Mapping[str, Any]], corners: bool) -> Joined:
    """Join the areas of all blocks of a raster.

    Parameters
    ----------
    blocks : mapping
        First row and column of each block -> its ``sides``, see `label_block`, and the number of its ``labels``.
    corners : bool
        Whether cells that touch at a corner belong together.
    """
    pieces = [
        Piece(*first_cell, label)
        for first_cell in sorted(blocks)
        for label in range(1, blocks[first_cell]["labels"] + 1)
    ]
    sides = {first_cell: counts["sides"] for first_cell, counts in blocks.items()}
    return Joined(
        {area[0]: tuple(area) for area in components(pieces, touching(sides, corners))}
    )


def areas_within(
    labels: Int32, window: Block, joins: Iterable[tuple[Piece, Piece]]
) -> tuple[Int32, list[Piece]]:
    """Find the areas in a window of a raster of labels.

    Parameters
    ----------
    labels : int32, shape (height, width)
        Labels in the window.
    window : Block
    joins : iterable of (Piece, Piece)
        Result of `Joined.joins` for the blocks that the window touches.

    Returns
    -------
    numbers : int32, shape (height, width)
        Number of the area in each cell, 0 for none.
    names : list of Piece
        Names of the areas with the numbers 1, 2, ...
    """
    numbers, names = np.zeros_like(labels), dict[Piece, int]()
    known = dict(joins)
    for row in range(
        window.row // BLOCK_PIXELS * BLOCK_PIXELS, window.row + window.height, BLOCK_PIXELS
    ):
        for col in range(
            window.col // BLOCK_PIXELS * BLOCK_PIXELS, window.col + window.width, BLOCK_PIXELS
        ):
            part = part_of(window, row, col)
            # like np.unique, but without sorting
            present = np.flatnonzero(np.bincount(labels[part].ravel()))
            table = np.zeros(int(present.max(initial=0)) + 1, np.int32)
            for label in present[present > 0].tolist():
                piece = Piece(row, col, label)
                table[label] = names.setdefault(known.get(piece, piece), len(names) + 1)
            numbers[part] = table[labels[part]]
    return numbers, list(names)


def cells_of(
    store: TileStore, name: str, coarse: RasterSpec, window: Block, pieces: Iterable[Piece]
) -> Bool:
    """Return a mask of the cells of some pieces in a window of a raster of labels in the store."""
    return cells_in(read_cells(store, name, coarse, window), window, pieces)


def cells_in(labels: Floating, window: Block, pieces: Iterable[Piece]) -> Bool:
    """Return a mask of the cells of some pieces in a window of labels."""
    cell_mask = np.zeros(labels.shape, np.bool_)
    of_block: dict[tuple[int, int], list[int]] = defaultdict(list)
    for piece in pieces:
        of_block[piece.row, piece.col].append(piece.label)
    for (row, col), piece_labels in of_block.items():
        part = part_of(window, row, col)
        cell_mask[part] = np.isin(labels[part], piece_labels)
    return cell_mask


def part_of(window: Block, row: int, col: int) -> tuple[slice, slice]:
    """Return the rows and columns of a window that lie in a block."""
    return (
        slice(max(row - window.row, 0), max(row + BLOCK_PIXELS - window.row, 0)),
        slice(max(col - window.col, 0), max(col + BLOCK_PIXELS - window.col, 0)),
    )


def around(row: int, col: int) -> list[tuple[int, int]]:
    """Return first row and column of a block and of its eight neighbours, even if some do not exist."""
    steps = (-BLOCK_PIXELS, 0, BLOCK_PIXELS)
    return [(row + down, col + right) for down in steps for right in steps]


STRIP_ROWS = 256
"""Rows per strip, or twice the radius if that is more."""


def within(cells: Bool, radius: float) -> Bool:
    """Return a mask of the cells within a radius of a set cell, measured between centres in cells.

    The cells are spread sideways step by step, and shifted up and down from the most distant
    row of a disk to its middle, where the disk is widest. For usual radii this takes a tenth of
    the time of a distance transform.
    """
    near_mask = np.zeros(cells.shape, np.bool_)
    box = box_around(cells, max(math.floor(radius), 0))
    source, near = cells[box], near_mask[box]
    spread = source.copy()
    width = 0
    for rows in range(min(math.floor(radius), len(source)), -1, -1):
        while width < source.shape[1] and math.sqrt((width + 1) ** 2 + rows**2) <= radius:
            width += 1
            spread[:, width:] |= source[:, :-width]
            spread[:, :-width] |= source[:, width:]
        near[rows:] |= spread[: len(spread) - rows]
        near[: len(near) - rows] |= spread[rows:]
    return near_mask


def opened(cells: Bool, radius: float) -> Bool:
    """Return a mask without the parts in which no disk of this radius fits. Cells beyond the border are not set."""
    pad = math.floor(radius)
    outside = np.pad(~cells, pad, constant_values=True)
    eroded = ~within(outside, radius)[pad : pad + len(cells), pad : pad + cells.shape[1]]
    return within(eroded, radius)


def within_square(cells: Bool, radius: int) -> Bool:
    """Return a mask of the cells with a set cell within ``radius`` rows and columns."""
    near = cells.copy()
    for step in range(1, radius + 1):
        near[step:] |= cells[:-step]
        near[:-step] |= cells[step:]
    rows = near.copy()
    for step in range(1, radius + 1):
        near[:, step:] |= rows[:, :-step]
        near[:, :-step] |= rows[:, step:]
    return near


def distances(cells: Bool, radius: float) -> Float64:
    """Return the distance of each cell from the nearest set cell, in cells, infinite beyond a radius."""
    near_distances = np.full(cells.shape, np.inf)
    for part, distance in _strips(cells, radius):
        np.copyto(near_distances[part], distance, where=distance <= radius)
    return near_distances


def box_around(cells: Bool, pad: int) -> tuple[slice, slice]:
    """Return the rows and columns of the box around the set cells, padded by ``pad`` cells within the array."""
    slices = []
    for axis in (1, 0):
        lines = np.flatnonzero(cells.any(axis=axis))
        first, last = (int(lines[0]), int(lines[-1])) if len(lines) else (0, -1)
        slices.append(slice(max(first - pad, 0), last + 1 + pad))
    return slices[0], slices[1]


def _strips(cells: Bool, radius: float) -> Iterator[tuple[tuple[slice, slice], Float64]]:
    """Yield the parts with set cells near them, and their distances, which are correct up to the radius."""
    margin = max(math.floor(radius), 0)
    step = max(STRIP_ROWS, 2 * margin)
    rows, cols = box_around(cells, margin)
    for first in range(rows.start, min(rows.stop, len(cells)), step):
        top, end = max(first - margin, 0), min(first + step, rows.stop)
        strip = cells[top : end + margin, cols]
        if strip.any():
            distance = scipy.ndimage.distance_transform_edt(~strip)[first - top :][
                : end - first
            ]
            yield (slice(first, first + len(distance)), cols), distance
