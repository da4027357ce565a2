"""Tasks that search for water block by block, and the decisions on whole areas between these tasks.

A candidate is a connected area of cells that may be water (see `tiler.grid.water_search`). A
plane is a level area that may be water (see `tiler.grid.water_planes`). Both are areas that can
extend over several blocks. The name of an area is its first `Piece`. The rim of an area is the
land around it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

from tiler.core.lattice import Bounds
from tiler.core.raster import BLOCK_PIXELS
from tiler.grid import (
    CountPlaneRims,
    CountRims,
    CrownsBlock,
    FindAreas,
    FinishWater,
    GroundCells,
    KeepAreas,
    KeepPlanes,
    Sources,
)
from tiler.grid.coarse import padded
from tiler.grid.pieces import Joined, Piece, around
from tiler.grid.records import BlockRecord, RimsRecord, SizesRecord
from tiler.grid.returns import usual_returns
from tiler.grid.steps import Counts
from tiler.grid.tasks.gridding import GridContext, Place, RasterStep
from tiler.grid.tasks.survey import block_names, near_places
from tiler.grid.water_cells import ENOUGH_RETURNS, CellCounts, Rim, water_confidence
from tiler.grid.water_find import MIN_LENGTH
from tiler.grid.water_ground import NEAR_CELLS
from tiler.grid.water_planes import DAM_M, SHORE_CELLS, Plane
from tiler.schedule import Task

AnyWork = TypeVar("AnyWork")


def counts_at(context: GridContext, raster: str) -> dict[Place, Counts]:
    """Return the counts of each finished block of a raster of coarse cells, by place."""
    return {(block.row, block.col): counts for block, counts in context.counts(raster).items()}


def ground_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block of coarse cells that overlaps a block of the terrain with heights."""
    if not context.water_is_sought:
        return
    terrain, coarse_terrain, occupancy = raster.inputs
    coarse, spec = context.coarse, context.spec
    if context.has_large_pixels:
        spec, terrain = coarse, coarse_terrain
    records = counts_at(context, occupancy)
    places: set[Place] = set()
    for key, (_, stored) in context.made[terrain].items():
        if BlockRecord.of(stored).filled:
            bounds = spec.block_bounds(spec.block_named(key, BLOCK_PIXELS))
            places.update(
                (block.row, block.col) for block in coarse.blocks_within(bounds, BLOCK_PIXELS)
            )
    for place in sorted(places):
        block = coarse.block_at(*place, BLOCK_PIXELS)
        has_water_class = any(
            records[other]["water"] for other in around(*place) if other in records
        )
        work = GroundCells(
            name=raster.name, spec=coarse, block=block, heights=terrain, pixels=spec,
            occupancy=occupancy if has_water_class else None, rule=context.rule,
        )  # fmt: skip
        blocks = [
            other.name for other in spec.blocks_within(coarse.block_bounds(block), BLOCK_PIXELS)
        ]
        inputs: list[Any] = [context.checksums(terrain, blocks)]
        if has_water_class:
            margin = int(NEAR_CELLS * coarse.lattice.size) + 1
            near = context.plan.buckets.among(
                coarse.block_bounds(block).pad(margin), context.labels
            )
            inputs.append(
                context.checksums(occupancy, block_names(near_places(coarse, [place])))
            )
            inputs.append(context.label_digests(near))
        yield context.block_task(raster, work, inputs)


def areas_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block of the survey that may have water.

    A block may have water if the usual number of returns per cell is known in the block and its
    neighbours, or if the input has the class of water there.
    """
    occupancy, ground, domain = raster.inputs
    records = counts_at(context, occupancy)
    for place, record in context.records(domain, BlockRecord).items():
        near = [other for other in around(*place) if other in records]
        usual = None
        if context.returns_show_water:
            usual = usual_returns((records[other]["returns"] for other in near), ENOUGH_RETURNS)
        has_water_class = any(records[other]["water"] for other in near)
        if not record.filled or (usual is None and not has_water_class):
            continue
        n_merged, median = usual or (1, None)
        work = FindAreas(
            name=raster.name, spec=context.coarse, block=context.coarse.block_at(*place, BLOCK_PIXELS),
            sources=Sources(occupancy, ground, domain), n_merged=n_merged, usual=median,
        )  # fmt: skip
        yield context.block_task(raster, work, _near_checksums(context, raster.inputs, place))


def rims_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block with a candidate and for its neighbours. The task counts the rims of candidates."""
    areas = raster.inputs[0]
    for place in _near_labels(context, areas):
        work = _on_areas(CountRims, raster, context, place)
        yield context.block_task(raster, work, _near_checksums(context, raster.inputs, place))


def plane_rims_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block with a plane that may be water, and for its neighbours."""
    planes = raster.inputs[0]
    evident, others = _likely_planes(context, planes)
    evident_at = _by_place(context.areas(planes), evident)
    others_at = _by_place(context.areas(planes), others)
    for place in near_places(context.coarse, {*evident_at, *others_at}):
        work = _on_areas(
            CountPlaneRims,
            raster,
            context,
            place,
            evident=_names_near(evident_at, place),
            others=_names_near(others_at, place),
        )
        yield context.block_task(raster, work, _near_checksums(context, raster.inputs, place))


def plane_sure_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block with a plane that is water, and for its neighbours."""
    rims, *inputs = raster.inputs
    kept = _kept_planes(context, inputs[0], rims)
    names_by_place = _by_place(context.areas(inputs[0]), kept)
    for place in near_places(context.coarse, names_by_place):
        names = _names_near(names_by_place, place)
        work = _on_areas(
            KeepPlanes, raster, context, place, kept=tuple((name, kept[name]) for name in names)
        )
        yield context.block_task(raster, work, _near_checksums(context, inputs, place))


def sure_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block with a candidate that is water."""
    rims, *inputs = raster.inputs
    areas = inputs[0]
    kept = _kept_areas(context, areas, rims)
    for place, names in _by_place(context.areas(areas), kept).items():
        work = _on_areas(
            KeepAreas, raster, context, place, kept=tuple((name, kept[name]) for name in names)
        )
        yield context.block_task(raster, work, [context.checksums(areas, block_names([place]))])


def crowns_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block with water, and for its neighbours, if the pulses pass through crowns (LiDAR)."""
    if not context.returns_show_water:
        return
    sure, planes, occupancy, ground = raster.inputs
    for place in _near_water(context, sure, planes):
        block = context.coarse.block_at(*place, BLOCK_PIXELS)
        work = CrownsBlock(
            name=raster.name,
            spec=context.coarse,
            block=block,
            confidences=(sure, planes),
            occupancy=occupancy,
            ground=ground,
            rule=context.rule,
        )
        margin = int(context.coarse.lattice.size) + 1
        near = context.plan.buckets.among(
            context.coarse.block_bounds(block).pad(margin), context.labels
        )
        yield context.block_task(
            raster,
            work,
            [*_near_checksums(context, raster.inputs, place), context.label_digests(near)],
        )


def _near_water(context: GridContext, *confidences: str) -> list[Place]:
    """Return the places of blocks with water and of their neighbours.

    ``confidences`` are rasters of the confidence that cells are water.
    """
    places: set[Place] = set()
    for name in confidences:
        records = context.records(name, BlockRecord)
        places.update(place for place, record in records.items() if record.filled)
    return near_places(context.coarse, places)


def cells_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block with water, and for its neighbours."""
    sure, planes, crowns, *sources = raster.inputs
    config = context.plan.config
    for place in _near_water(context, sure, planes):
        work = FinishWater(
            name=raster.name,
            spec=context.coarse,
            block=context.coarse.block_at(*place, BLOCK_PIXELS),
            confidences=(sure, planes),
            crowns=crowns,
            sources=Sources(*sources),
            river_width_m=float(config.water_min_river_width),
            island_m2=float(config.water_min_island),
            decks=_decks_near(context, place),
        )
        yield context.block_task(raster, work, _near_checksums(context, raster.inputs, place))


def _decks_near(context: GridContext, place: Place) -> tuple[tuple[int, ...], ...]:
    """Return the outlines of the removed bridges in a block and its neighbours."""
    block = context.coarse.block_at(*place, BLOCK_PIXELS)
    bounds = context.coarse.block_bounds(padded(block, BLOCK_PIXELS))
    rings = []
    for ring, *_ in context.corrections.decks:
        x, y = ring[::2], ring[1::2]
        if bounds.overlaps(Bounds(min(x), min(y), max(x), max(y))):
            rings.append(ring)
    return tuple(rings)


def _on_areas(
    make: Callable[..., AnyWork],
    raster: RasterStep,
    context: GridContext,
    place: Place,
    **more: Any,
) -> AnyWork:
    """Make the arguments of a task on candidates or planes."""
    areas, occupancy, ground, domain = raster.inputs[-4:]
    record = context.records(areas, SizesRecord).get(place)
    return make(
        name=raster.name,
        spec=context.coarse,
        block=context.coarse.block_at(*place, BLOCK_PIXELS),
        sources=Sources(occupancy, ground, domain),
        n_merged=1 if record is None else record.n_merged,
        areas=areas,
        joins=context.areas(areas).joins(around(*place)),
        **more,
    )


def _near_checksums(context: GridContext, rasters: Sequence[str], place: Place) -> list[Any]:
    """Return the checksums of a block and its neighbours for some rasters."""
    near = block_names(near_places(context.coarse, [place]))
    return [context.checksums(name, near) for name in rasters]


def _near_labels(context: GridContext, areas: str) -> list[Place]:
    """Return the places of blocks with labels in a raster of areas, and of their neighbours."""
    labelled = [
        place for place, record in context.records(areas, SizesRecord).items() if record.labels
    ]
    return near_places(context.coarse, labelled)


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
    names: set[Piece] = set()
    for other in around(*place):
        names.update(names_by_place.get(other, ()))
    return tuple(sorted(names))


def _sizes(context: GridContext, areas: str) -> dict[Piece, tuple[int, ...]]:
    """Return `area_sums` for the areas of a raster."""
    return area_sums(context.areas(areas), context.records(areas, SizesRecord))


def area_sums(
    joined: Joined, records: Mapping[Place, SizesRecord]
) -> dict[Piece, tuple[int, ...]]:
    """Return the sums of ``sizes`` of the records (see `SizesRecord`) over the pieces of each area, by its name."""
    sums = {}
    for name, pieces in joined.areas.items():
        sizes = [records[p.row, p.col].sizes[p.label - 1] for p in pieces]
        sums[name] = tuple(map(sum, zip(*sizes, strict=True)))
    return sums


def _kept_areas(context: GridContext, areas: str, rims: str) -> dict[Piece, float]:
    """Return the candidates that are water, each with its confidence."""
    rim_by_area = _rims(context, rims)
    kept = {}
    for name, size in _sizes(context, areas).items():
        confidence = water_confidence(CellCounts(*size), rim_by_area.get(name, Rim()))
        if confidence is not None:
            kept[name] = confidence
    return kept


def _rims(context: GridContext, rims: str, number: int = 0) -> dict[Piece, Rim]:
    """Return the rim of each area, added up over blocks.

    Evident planes have two rims. In the second one, with ``number`` 1, other planes do not
    count as land.
    """
    rim_by_area: dict[Piece, Rim] = {}
    for record in context.records(rims, RimsRecord).values():
        for name, *counts in record.rims:
            rim = Rim(*counts[min(number, len(counts) - 1)])
            rim_by_area[Piece(*name)] = rim_by_area.get(Piece(*name), Rim()).plus(rim)
    return rim_by_area


def _likely_planes(context: GridContext, planes: str) -> tuple[list[Piece], list[Piece]]:
    """Return the evident planes that are large enough, and other planes that may lie next to evident planes.

    The rims of the planes are not used.
    """
    config = context.plan.config
    joined, records = context.areas(planes), context.records(planes, SizesRecord)
    min_m2 = float(min(config.water_min_lake, MIN_LENGTH * config.water_min_river_width**2))
    # The cells along the shore are not part of a plane, so half of the area is enough.
    min_cells = min_m2 / float(context.coarse_m) ** 2 / 2
    sizes = {}
    for name, size in area_sums(joined, records).items():
        if size[0] >= min_cells:
            sizes[name] = Plane(*size)
    boxes = {name: _box(joined.areas[name], records) for name in sizes}
    evident = [name for name, plane in sizes.items() if plane.is_evident]
    max_gap = DAM_M / float(context.coarse_m) + SHORE_CELLS
    others = []
    for name in sizes.keys() - set(evident):
        if any(_are_near(boxes[name], boxes[other], max_gap) for other in evident):
            others.append(name)
    return sorted(evident), sorted(others)


def _box(
    pieces: Iterable[Piece], records: Mapping[Place, SizesRecord]
) -> tuple[int, int, int, int]:
    """Return the first row and column, and the last row and column plus 1, of an area."""
    boxes = [(records[p.row, p.col].boxes or [])[p.label - 1] for p in pieces]
    top, left, bottom, right = zip(*boxes, strict=True)
    return min(top), min(left), max(bottom), max(right)


def _are_near(box: Sequence[int], other: Sequence[int], max_gap: float) -> bool:
    gaps = (max(box[i], other[i]) - min(box[i + 2], other[i + 2]) for i in (0, 1))
    return all(gap <= max_gap for gap in gaps)


def _kept_planes(context: GridContext, planes: str, rims: str) -> dict[Piece, float]:
    """Return the planes that are water, each with its confidence: evident planes, and other planes next to these."""
    evident, others = _likely_planes(context, planes)
    confidences = _plane_confidences(context, rims, 0)
    confidences_without_others = _plane_confidences(context, rims, 1)
    neighbours: dict[Piece, set[Piece]] = defaultdict(set)
    for record in context.records(rims, RimsRecord).values():
        for name, other in record.beside or ():
            neighbours[Piece(*name)].add(Piece(*other))
    kept = {name: confidences[name] for name in evident if name in confidences}
    other_water = {name: confidences[name] for name in others if name in confidences}
    # The planes above and below a dam may both be water. So planes of ``others`` that are water
    # do not count as land in the rims of the evident planes next to them.
    next_to_others: set[Piece] = set()
    for name in other_water:
        next_to_others |= neighbours[name]
    for name in evident:
        if name in next_to_others and name in confidences_without_others:
            kept[name] = confidences_without_others[name]
    evident_water = set(kept)
    for name, confidence in other_water.items():
        if neighbours[name] & evident_water:
            kept[name] = confidence
    return kept


def _plane_confidences(context: GridContext, rims: str, number: int) -> dict[Piece, float]:
    """Return the confidences of the planes that are water according to the rim ``number`` (see `_rims`)."""
    confidences = {}
    for name, rim in _rims(context, rims, number).items():
        confidence = water_confidence(CellCounts(), rim)
        if confidence:
            confidences[name] = confidence
    return confidences
