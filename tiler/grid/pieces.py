"""Connected areas of a coarse raster, which is labelled block by block.

A task labels the areas of its block and records the labels along the block's sides. The
coordinator joins areas that touch, so that an array of the whole raster is never needed.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
import scipy

from tiler.core.raster import BLOCK_PIXELS, Block, RasterSpec
from tiler.grid.coarse import Bools
from tiler.store import TileStore, read_cells

Node = TypeVar("Node")

Labels = npt.NDArray[np.int32]
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


def label_block(cells: Bools, corners: bool) -> tuple[Labels, dict[str, Side]]:
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


def _runs(line: npt.NDArray[Any]) -> Side:
    starts = np.flatnonzero(np.diff(line, prepend=line[0] - 1))
    lengths = np.diff(starts, append=len(line))
    return [
        [int(label), int(length)] for label, length in zip(line[starts], lengths, strict=True)
    ]


def side_labels(side: Side) -> Labels:
    """Return the label of each cell along a side of a block."""
    labels, lengths = np.array(side, np.int32).T
    cell_labels: Labels = np.repeat(labels, lengths)
    return cell_labels


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
                    side_labels(sides[side]), side_labels(blocks[other][facing_side]), corners
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


def _facing(mine: Labels, theirs: Labels, corners: bool) -> Iterable[tuple[int, int]]:
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
    ends = np.array([[node_index[a], node_index[b]] for a, b in pairs], np.int64).reshape(-1, 2)
    graph = scipy.sparse.coo_array((np.ones(len(ends)), ends.T), (len(listed), len(listed)))
    groups: dict[int, list[Node]] = {}
    if listed:
        _, numbers = scipy.sparse.csgraph.connected_components(graph, directed=False)
        for node, number in zip(listed, numbers.tolist(), strict=True):
            groups.setdefault(number, []).append(node)
    return list(groups.values())


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


def join_pieces(
    blocks: Mapping[tuple[int, int], Mapping[str, Side]],
    counts: Mapping[tuple[int, int], int],
    corners: bool,
) -> Joined:
    """Join the areas of all blocks of a raster.

    Parameters
    ----------
    blocks : mapping
        First row and column of each block -> its sides, see `label_block`.
    counts : mapping
        Number of labels of each block.
    corners : bool
        Whether cells that touch at a corner belong together.
    """
    pieces = [
        Piece(*first_cell, label)
        for first_cell in sorted(counts)
        for label in range(1, counts[first_cell] + 1)
    ]
    return Joined(
        {area[0]: tuple(area) for area in components(pieces, touching(blocks, corners))}
    )


def areas_within(
    labels: Labels, window: Block, joins: Iterable[tuple[Piece, Piece]]
) -> tuple[Labels, list[Piece]]:
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
) -> Bools:
    """Return a mask of the cells of some pieces in a window of a raster of labels in the store."""
    return cells_in(read_cells(store, name, coarse, window), window, pieces)


def cells_in(labels: npt.NDArray[np.floating], window: Block, pieces: Iterable[Piece]) -> Bools:
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
