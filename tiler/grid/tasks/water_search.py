"""Tasks that search for water block by block, and the decisions on whole areas between these tasks.

A candidate is a connected area of cells that may be water (see `tiler.grid.water_search`). A
plane is a level area that may be water (see `tiler.grid.water_planes`). Both are areas that can
extend over several blocks. The name of an area is its first `Piece`. The rim of an area is the
land around it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from typing import Any

from tiler.core.lattice import Bounds
from tiler.core.products import Read
from tiler.core.raster import BLOCK_PIXELS, Block
from tiler.grid.coarse import Joined, Piece, around, padded
from tiler.grid.coverage import usual_returns
from tiler.grid.steps import Counts
from tiler.grid.tasks.gridding import Grid, GridContext, Place, coarse_cell_m, has_large_pixels
from tiler.grid.tasks.steps import NONE, Near, Over, Step, Values, near_blocks, near_places
from tiler.grid.water_cells import (
    ENOUGH_RETURNS,
    NEAR_CELLS,
    CellCounts,
    Rim,
    ground_cells,
    water_confidence,
)
from tiler.grid.water_extent import finish_margin, finish_water
from tiler.grid.water_find import MIN_LENGTH
from tiler.grid.water_planes import (
    DAM_M,
    SHORE_CELLS,
    Plane,
    count_plane_rims,
    find_planes,
    keep_planes,
)
from tiler.grid.water_plants import crowns_margin, plants_near_water
from tiler.grid.water_search import MARGIN, count_rims, find_areas, keep_areas
from tiler.plan import Plan

Reads = Mapping[str, Read]


def water_steps(plan: Plan) -> list[Step]:
    """Return the steps of the search for water in coarse cells."""
    config, cell_m = plan.config, float(coarse_cell_m(plan))
    width_m, island_m2 = float(config.water_min_river_width), float(config.water_min_island)
    margin = finish_margin(cell_m, width_m, island_m2)
    crowns = crowns_margin(cell_m)
    finish = {"margin": margin, "river_width_m": width_m, "island_m2": island_m2}
    found = {"sure": "water-sure", "planes": "water-plane-sure"}

    def step(
        name: str,
        work: Callable[..., Any],
        reads: Reads,
        over: Over,
        *after: str,
        **values: Any,
    ) -> Step:
        grid = Grid.COARSE
        return Step(
            f"water-{name}", work, reads, over, values, fill=0.0, grid=grid, after=after
        )

    def near(margin: int, **names: str) -> dict[str, Read]:
        return {key: Read(f"numbers:{name}", margin) for key, name in names.items()}

    heights = "same-cells:water-terrain" if has_large_pixels(plan) else "pixels:dtm"
    cell = plan.frame.counts(coarse_cell_m(plan))
    search = _search(MARGIN)
    areas = {**near(MARGIN, areas="water-areas"), **search}
    planes = {**near(MARGIN, areas="water-planes"), **search}
    return [
        Step(
            "water-ground",
            ground_cells,
            {
                "heights": Read(heights),
                **near(NEAR_CELLS, occupancy="occupancy"),
                "points": Read("points", int(NEAR_CELLS * cell) + 1),
                "place": Read("place"),
            },
            _with_heights,
            grid=Grid.COARSE,
        ),
        step("areas", find_areas, search, _may_have_water),
        step("rims", count_rims, areas, _near_candidates),
        step(
            "sure",
            keep_areas,
            {**near(0, areas="water-areas"), "place": Read("place")},
            _kept_areas,
            "water-rims",
        ),
        step("planes", find_planes, search, _may_have_water),
        step("plane-rims", count_plane_rims, planes, _near_planes),
        step("plane-sure", keep_planes, planes, _kept_planes, "water-plane-rims"),
        step(
            "crowns",
            plants_near_water,
            {
                **near(crowns, **found),
                **near(1, occupancy="occupancy"),
                "ground": Read("raster:water-ground", 1),
                "points": Read("points", int(cell) + 1),
                "place": Read("place"),
            },
            _near_water_of_pulses,
            margin=crowns,
        ),
        step(
            "cells",
            finish_water,
            {**near(margin, **found, crowns="water-crowns"), **_search(margin)},
            _near_water,
            **finish,
        ),
    ]


def _search(margin: int) -> dict[str, Read]:
    """Return the reads of `SearchRead`."""
    return {
        "occupancy": Read("numbers:occupancy", margin),
        "ground": Read("raster:water-ground", margin),
        "domain": Read("numbers:domain", margin),
        "place": Read("place"),
    }


def _with_heights(step: Step, context: GridContext, _: Near) -> Mapping[Block, Values]:
    """Return the blocks that overlap a block of the terrain with heights, if water is sought."""
    if not context.water_is_sought:
        return {}
    coarse = context.coarse
    read = step.reads["heights"]
    spec = context.spec if read.kind == "pixels" else coarse
    blocks: set[Block] = set()
    for key, (_digest, terrain) in context.made[read.raster].items():
        if terrain["filled"]:
            bounds = spec.block_bounds(spec.block_named(key, BLOCK_PIXELS))
            blocks.update(coarse.blocks_within(bounds, BLOCK_PIXELS))
    wet = set(context.places_with("occupancy", "water"))
    return {
        block: {"is_wet": not wet.isdisjoint(around(block.row, block.col))} for block in blocks
    }


def _may_have_water(_: Step, context: GridContext, __: Near) -> Mapping[Block, Values]:
    """Return the blocks of the survey that may have water.

    A block may have water if the usual number of returns per cell is known in the block and its
    neighbours, or if the input has the class of water there.
    """
    counts, values = context.counts_at("occupancy"), {}
    for block, domain in context.counts("domain").items():
        near = [counts[at] for at in around(block.row, block.col) if at in counts]
        usual = None
        if context.returns_show_water:
            usual = usual_returns((other["returns"] for other in near), ENOUGH_RETURNS)
        has_water_class = any(other["water"] for other in near)
        if domain["filled"] and (usual is not None or has_water_class):
            n_merged, median = usual or (1, None)
            values[block] = {"n_merged": n_merged, "usual": median}
    return values


def _near_candidates(_: Step, context: GridContext, __: Near) -> Mapping[Block, Values]:
    """Return the blocks with a candidate and their neighbours."""
    areas = "water-areas"
    labelled = context.places_with(areas, "labels")
    return _on_areas(context, areas, near_places(context.coarse, labelled))


def _kept_areas(_: Step, context: GridContext, __: Near) -> Mapping[Block, Values]:
    """Return the blocks with a candidate that is water."""
    areas = "water-areas"
    kept = _confident_areas(context, areas, "water-rims")
    at = _by_place(context.areas(areas), kept)
    values = _on_areas(context, areas, at, kept=lambda place: [(n, kept[n]) for n in at[place]])
    return {block: {n: v[n] for n in ("joins", "kept")} for block, v in values.items()}


def _near_planes(_: Step, context: GridContext, __: Near) -> Mapping[Block, Values]:
    """Return the blocks with a plane that may be water, and their neighbours."""
    planes = "water-planes"
    evident, others = (
        _by_place(context.areas(planes), names) for names in _likely_planes(context, planes)
    )
    return _on_areas(
        context,
        planes,
        near_places(context.coarse, {*evident, *others}),
        evident=lambda place: _names_near(evident, place),
        others=lambda place: _names_near(others, place),
    )


def _kept_planes(_: Step, context: GridContext, __: Near) -> Mapping[Block, Values]:
    """Return the blocks with a plane that is water, and their neighbours."""
    planes = "water-planes"
    kept = _confident_planes(context, planes, "water-plane-rims")
    at = _by_place(context.areas(planes), kept)
    return _on_areas(
        context,
        planes,
        near_places(context.coarse, at),
        kept=lambda place: [(name, kept[name]) for name in _names_near(at, place)],
    )


def _on_areas(
    context: GridContext,
    areas: str,
    places: Iterable[Place],
    **more: Callable[[Place], Any],
) -> dict[Block, Values]:
    """Return the values of steps on candidates or planes at some places."""
    counts, joined = context.counts_at(areas), context.areas(areas)
    values: dict[Block, Values] = {}
    for place in places:
        values[context.coarse.block_at(*place, BLOCK_PIXELS)] = {
            "n_merged": counts[place]["n_merged"] if place in counts else 1,
            "joins": joined.joins(around(*place)),
            **{name: of_place(place) for name, of_place in more.items()},
        }
    return values


def _near_water_of_pulses(_: Step, context: GridContext, near: Near) -> Mapping[Block, Values]:
    """Return the blocks with water and their neighbours, if the pulses pass through crowns (LiDAR)."""
    if not context.returns_show_water:
        return {}
    return dict.fromkeys(_blocks_near_water(context), NONE)


def _near_water(_: Step, context: GridContext, __: Near) -> Mapping[Block, Values]:
    """Return the blocks with water and their neighbours."""
    return {
        block: {"decks": _decks_near(context, block)} for block in _blocks_near_water(context)
    }


def _blocks_near_water(context: GridContext) -> list[Block]:
    of_rasters = (
        context.places_with(name, "filled") for name in ("water-sure", "water-plane-sure")
    )
    return near_blocks(context.coarse, chain.from_iterable(of_rasters))


def _decks_near(context: GridContext, block: Block) -> list[tuple[int, ...]]:
    """Return the outlines of the removed bridges in a block and its neighbours."""
    bounds = context.coarse.block_bounds(padded(block, BLOCK_PIXELS))
    rings = []
    for ring, *_ in context.corrections.decks:
        x, y = ring[::2], ring[1::2]
        if bounds.overlaps(Bounds(min(x), min(y), max(x), max(y))):
            rings.append(ring)
    return rings


def _by_place(joined: Joined, names: Iterable[Piece]) -> dict[Place, list[Piece]]:
    """Return the names of the areas that extend into each block, for some areas."""
    names_by_place: dict[Place, list[Piece]] = defaultdict(list)
    for name in sorted(names):
        for place in sorted({(piece.row, piece.col) for piece in joined.areas[name]}):
            names_by_place[place].append(name)
    return names_by_place


def _names_near(
    names_by_place: Mapping[Place, Sequence[Piece]], place: Place
) -> tuple[Piece, ...]:
    """Return the names of the areas that extend into a block or its neighbours."""
    names = {name for other in around(*place) for name in names_by_place.get(other, ())}
    return tuple(sorted(names))


def area_sums(context: GridContext, areas: str) -> dict[Piece, tuple[int, ...]]:
    """Return the sums of ``sizes`` of the counts over the pieces of each area of a raster, by its name."""
    counts, sums = context.counts_at(areas), {}
    for name, pieces in context.areas(areas).areas.items():
        sizes = [counts[p.row, p.col]["sizes"][p.label - 1] for p in pieces]
        sums[name] = tuple(map(sum, zip(*sizes, strict=True)))
    return sums


def _confident_areas(context: GridContext, areas: str, rims: str) -> dict[Piece, float]:
    """Return the candidates that are water, each with its confidence."""
    rim_by_area = _rims(context, rims)
    confidences = {
        name: water_confidence(CellCounts(*size), rim_by_area.get(name, Rim()))
        for name, size in area_sums(context, areas).items()
    }
    return _of_water(confidences)


def _of_water(confidences: Mapping[Piece, float | None]) -> dict[Piece, float]:
    """Return the areas that are not land (see `water_confidence`)."""
    return {name: sure for name, sure in confidences.items() if sure is not None}


def _rims(context: GridContext, rims: str, number: int = 0) -> dict[Piece, Rim]:
    """Return the rim of each area, added up over blocks.

    Evident planes have two rims. In the second one, with ``number`` 1, other planes do not
    count as land.
    """
    rim_by_area: dict[Piece, Rim] = {}
    for found in context.counts(rims).values():
        for name, *counts in found["rims"]:
            rim = Rim(*counts[min(number, len(counts) - 1)])
            rim_by_area[Piece(*name)] = rim_by_area.get(Piece(*name), Rim()).plus(rim)
    return rim_by_area


def _likely_planes(context: GridContext, planes: str) -> tuple[list[Piece], list[Piece]]:
    """Return the evident planes that are large enough, and other planes that may lie next to evident planes.

    The rims of the planes are not used.
    """
    config = context.plan.config
    joined, counts = context.areas(planes), context.counts_at(planes)
    min_m2 = float(min(config.water_min_lake, MIN_LENGTH * config.water_min_river_width**2))
    # The cells along the shore are not part of a plane, so half of the area is enough.
    min_cells = min_m2 / float(context.coarse_m) ** 2 / 2
    sums = area_sums(context, planes).items()
    sizes = {name: Plane(*size) for name, size in sums if size[0] >= min_cells}
    boxes = {name: _box(joined.areas[name], counts) for name in sizes}
    evident = [name for name, plane in sizes.items() if plane.is_evident]
    max_gap = DAM_M / float(context.coarse_m) + SHORE_CELLS
    others = [
        name
        for name in sizes.keys() - set(evident)
        if any(_are_near(boxes[name], boxes[other], max_gap) for other in evident)
    ]
    return sorted(evident), sorted(others)


def _box(pieces: Iterable[Piece], counts: Mapping[Place, Counts]) -> tuple[int, int, int, int]:
    """Return the first row and column, and the last row and column plus 1, of an area."""
    boxes = [counts[p.row, p.col]["boxes"][p.label - 1] for p in pieces]
    top, left, bottom, right = zip(*boxes, strict=True)
    return min(top), min(left), max(bottom), max(right)


def _are_near(box: Sequence[int], other: Sequence[int], max_gap: float) -> bool:
    gaps = (max(box[i], other[i]) - min(box[i + 2], other[i + 2]) for i in (0, 1))
    return all(gap <= max_gap for gap in gaps)


def _confident_planes(context: GridContext, planes: str, rims: str) -> dict[Piece, float]:
    """Return the planes that are water, each with its confidence: evident planes, and other planes next to these."""
    evident, others = _likely_planes(context, planes)
    confidences = _plane_confidences(context, rims, 0)
    confidences_without_others = _plane_confidences(context, rims, 1)
    neighbours: dict[Piece, set[Piece]] = defaultdict(set)
    for counts in context.counts(rims).values():
        for name, other in counts["beside"]:
            neighbours[Piece(*name)].add(Piece(*other))
    kept = {name: confidences[name] for name in evident if name in confidences}
    other_water = {name: confidences[name] for name in others if name in confidences}
    # The planes above and below a dam may both be water. So planes of ``others`` that are water
    # do not count as land in the rims of the evident planes next to them.
    next_to_others = set[Piece]().union(*(neighbours[name] for name in other_water))
    for name in next_to_others.intersection(evident, confidences_without_others):
        kept[name] = confidences_without_others[name]
    near_evident = {
        name: sure for name, sure in other_water.items() if neighbours[name] & kept.keys()
    }
    return kept | near_evident


def _plane_confidences(context: GridContext, rims: str, number: int) -> dict[Piece, float]:
    """Return the confidences of the planes that are water according to the rim ``number`` (see `_rims`)."""
    of_planes = _rims(context, rims, number).items()
    return _of_water({name: water_confidence(CellCounts(), rim) for name, rim in of_planes})
