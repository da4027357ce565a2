"""Tasks that find the extent of the survey and the voids of models, block by block of coarse cells."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from typing import Any

from tiler.core.raster import BLOCK_PIXELS, Block, RasterSpec, north_west
from tiler.grid import CloseBlock, FillBlock, FindVoids, SurveyBlock, Void, VoidRasters, blocks_of
from tiler.grid.pieces import Piece, Side, components, touching
from tiler.grid.tasks.gridding import GAP_M, GridContext, Place, RasterStep
from tiler.schedule import Task, digest_of
from tiler.version import __version__

Gap = tuple[str, int, int, int]
"""Run of missing blocks in a row between two existing ones: kind, first row, first columns of first and last block."""
BEYOND_ALL: Gap = ("outside", 0, 0, 0)
SIDES = {"north": (-1, 0), "south": (1, 0), "west": (0, -1), "east": (0, 1)}
"""Rows and columns, in blocks, from a block to its neighbour at each side."""


def survey_gaps(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block that a gap of the survey could reach."""
    return _close_tasks(raster, g, float(GAP_M / g.coarse_m))


def domain_gaps(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield the tasks of `survey_gaps` for gaps up to `--max-edge`, which could be water."""
    return (
        _close_tasks(raster, g, float(g.plan.config.max_edge / g.coarse_m)) if g.water_is_sought else iter(())
    )


def _close_tasks(raster: RasterStep, g: GridContext, gap: float) -> Iterator[Task]:
    coarse = g.coarse
    (occupancy,) = raster.inputs
    most = float(g.plan.config.max_edge / g.coarse_m)
    reach_blocks = math.ceil((most + 2) / BLOCK_PIXELS)
    occupied = [place for place, record in g.records(occupancy).items() if record["filled"]]
    for place in near_places(coarse, occupied, reach_blocks):
        work = CloseBlock(
            name=raster.name, spec=coarse, block=coarse.block_at(*place, BLOCK_PIXELS), occupancy=occupancy,
            gap=min(gap, most), most_gap=most,
        )  # fmt: skip
        seen = g.checksums(occupancy, names_of(near_places(coarse, [place], reach_blocks)))
        yield g.block_task(raster, work, [seen])


def near_places(coarse: RasterSpec, places: Iterable[Place], reach: int = 1) -> list[Place]:
    """Return the places of blocks and of their neighbours within the raster, from the north-west."""
    steps = [step * BLOCK_PIXELS for step in range(-reach, reach + 1)]
    places_around = {(row + down, col + right) for row, col in places for down in steps for right in steps}
    return sorted((r, c) for r, c in places_around if 0 <= r < coarse.height and 0 <= c < coarse.width)


def names_of(places: Iterable[Place]) -> list[str]:
    """Return the names of the blocks at some places."""
    return [Block(*place, 0, 0).name for place in places]


def survey_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block that was closed, and for each empty block that is enclosed."""
    coarse, (opened,) = g.coarse, raster.inputs
    records = g.records(opened)
    outside, empty = outside_of({place: record["sides"] for place, record in records.items()})
    for place in sorted({*records, *empty}):
        near = near_places(coarse, [place])
        work = SurveyBlock(
            name=raster.name, spec=coarse, block=coarse.block_at(*place, BLOCK_PIXELS), opened=opened,
            outside=tuple(piece for other in near for piece in outside.get(other, ())),
            empty=tuple(other for other in near if other in empty), pixels=g.spec,
        )  # fmt: skip
        yield g.block_task(raster, work, [g.checksums(opened, names_of(near))])


def outside_of(
    blocks: Mapping[Place, Mapping[str, Side]],
) -> tuple[dict[Place, list[Piece]], set[Place]]:
    """Find the open areas that reach the outside of a survey, and the empty blocks that do not.

    Parameters
    ----------
    blocks : mapping
        Labels of open areas along the sides of each block at or near an occupied block, by its place.

    Returns
    -------
    outside : dict
        Open areas of each place that are connected with the outside.
    empty : set
        Places of other blocks that are enclosed by the given blocks.
    """
    columns: dict[int, list[int]] = defaultdict(list)
    for row, col in sorted(blocks):
        columns[row].append(col)
    gaps = {row: _gaps(row, cols) for row, cols in columns.items()}
    pairs: list[tuple[Any, Any]] = [*touching(blocks, corners=False)]
    for (row, col), sides in blocks.items():
        for side, (down, right) in SIDES.items():
            neighbour = (row + down * BLOCK_PIXELS, col + right * BLOCK_PIXELS)
            if neighbour not in blocks:
                other = _gap_at(gaps, *neighbour)
                pairs += [(Piece(row, col, label), other) for label in _labels(sides[side])]
    for row, row_gaps in gaps.items():
        for gap in row_gaps:
            pairs += [(gap, other) for other in _facing(gap, row - BLOCK_PIXELS, gaps, columns)]
            pairs += [(gap, other) for other in _facing(gap, row + BLOCK_PIXELS, gaps, columns)]
    nodes = {node: None for pair in pairs for node in pair} | {BEYOND_ALL: None}
    (beyond,) = (set(group) for group in components(nodes, pairs) if BEYOND_ALL in group)
    outside: dict[Place, list[Piece]] = defaultdict(list)
    for piece in sorted(node for node in beyond if isinstance(node, Piece)):
        outside[piece.row, piece.col].append(piece)
    enclosed = (gap for row_gaps in gaps.values() for gap in row_gaps if gap not in beyond)
    empty = {(gap[1], col) for gap in enclosed for col in range(gap[2], gap[3] + 1, BLOCK_PIXELS)}
    return outside, empty


def _labels(side: Side) -> list[int]:
    return sorted({label for label, _ in side if label})


def _gaps(row: int, cols: list[int]) -> list[Gap]:
    """Return the gaps between the blocks of a row."""
    pairs = pairwise(cols)
    return [("gap", row, a + BLOCK_PIXELS, b - BLOCK_PIXELS) for a, b in pairs if b - a > BLOCK_PIXELS]


def _gap_at(gaps: Mapping[int, list[Gap]], row: int, col: int) -> Gap:
    """Return the gap at a place without a block, or `BEYOND_ALL`."""
    return next((gap for gap in gaps.get(row, ()) if gap[2] <= col <= gap[3]), BEYOND_ALL)


def _facing(gap: Gap, row: int, gaps: Mapping[int, list[Gap]], columns: Mapping[int, list[int]]) -> list[Gap]:
    """Return the gaps that a gap touches in the row above or below, and `BEYOND_ALL` if it touches the outside."""
    touched_gaps = [other for other in gaps.get(row, ()) if other[2] <= gap[3] and gap[2] <= other[3]]
    cols = columns.get(row)
    if cols is None or gap[2] < cols[0] or gap[3] > cols[-1]:
        touched_gaps.append(BEYOND_ALL)
    return touched_gaps


def voids_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block of coarse cells that overlaps the inside of the survey."""
    spec, coarse = g.spec, g.coarse
    model, survey = raster.inputs
    rasters = VoidRasters(model, spec, survey, coarse, raster.name)
    for place, record in g.records(survey).items():
        if not record["inside"]:
            continue
        block = coarse.block_at(*place, BLOCK_PIXELS)
        work = FindVoids(name=raster.name, spec=coarse, block=block, rasters=rasters)
        under = [other.name for other in spec.blocks_within(coarse.block_bounds(block), BLOCK_PIXELS)]
        yield g.block_task(raster, work, [g.checksums(model, under), g.checksums(survey, [block.name])])


def fill_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block of a model. It depends on all blocks around the voids that touch its block."""
    spec = g.spec
    model, survey, voids = raster.inputs
    rasters, records = VoidRasters(model, spec, survey, g.coarse, voids), g.records(voids)
    voids_of: dict[str, list[tuple[Void, str]]] = defaultdict(list)
    for pieces in g.areas(voids, corners=True).areas.values():
        runs = [run for p in pieces for run in records[p.row, p.col]["blocks"][p.label - 1]]
        near = sorted({block.name for block in blocks_of(runs, spec, BLOCK_PIXELS)})
        piece_blocks = names_of({(p.row, p.col) for p in pieces})
        rim = digest_of(g.checksums(model, near), g.checksums(voids, sorted(piece_blocks)))
        for key in near:
            voids_of[key].append((Void(pieces), rim))
    for key in sorted(voids_of.keys() | g.made[model].keys()):
        block_voids = voids_of.get(key, [])
        block = spec.block_named(key, BLOCK_PIXELS)
        work = FillBlock(raster.name, block, rasters, tuple(void for void, _ in block_voids))
        seen = [g.checksums(model, [key]), g.beneath(survey, block), [rim for _, rim in block_voids]]
        digest = digest_of(__version__, work, seen)
        yield Task(raster.stage, key, digest, raster.work, work, block.height * block.width)


def surveyed_blocks(g: GridContext, survey: str) -> list[Block]:
    """Return the products' blocks that overlap the inside of the survey, from the north-west."""
    runs = (run for record in g.records(survey).values() for run in record["blocks"])
    return sorted(set(blocks_of(list(runs), g.spec, BLOCK_PIXELS)), key=north_west)
