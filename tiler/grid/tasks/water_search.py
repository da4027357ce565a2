"""Tasks that search for water block by block, and decisions between them (see `tiler.grid.water_search`)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

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
from tiler.grid.returns import usual_returns
from tiler.grid.tasks.gridding import GridContext, Place, RasterStep
from tiler.grid.tasks.survey import names_of, near_places
from tiler.grid.water_cells import ENOUGH_RETURNS, Rim, Size, judged
from tiler.grid.water_find import MIN_LENGTH
from tiler.grid.water_ground import NEAR_CELLS
from tiler.grid.water_planes import DAM_M, SHORE_CELLS, Plane
from tiler.schedule import Task


def ground_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block of coarse cells that overlaps the terrain."""
    if not g.water_is_sought:
        return
    pixels, cells, occupancy = raster.inputs
    coarse, spec, terrain = g.coarse, g.spec, pixels
    if g.has_large_pixels:
        spec, terrain = coarse, cells
    records = g.records(occupancy)
    made = [key for key, (_, record) in g.made[terrain].items() if record["filled"]]
    places = {
        (block.row, block.col)
        for key in made
        for block in coarse.blocks_within(
            spec.block_bounds(spec.block_named(key, BLOCK_PIXELS)), BLOCK_PIXELS
        )
    }
    for place in sorted(places):
        block = coarse.block_at(*place, BLOCK_PIXELS)
        given = any(records[other]["water"] for other in around(*place) if other in records)
        work = GroundCells(
            name=raster.name, spec=coarse, block=block, heights=terrain, pixels=spec,
            occupancy=occupancy if given else None, rule=g.rule,
        )  # fmt: skip
        under = [other.name for other in spec.blocks_within(coarse.block_bounds(block), BLOCK_PIXELS)]
        seen: list[Any] = [g.checksums(terrain, under)]
        if given:
            margin = int(NEAR_CELLS * coarse.lattice.size) + 1
            near = g.plan.meta.bucket.among(coarse.block_bounds(block).pad(margin), g.labels)
            seen += [g.checksums(occupancy, names_of(near_places(coarse, [place]))), g.seen(near)]
        yield g.block_task(raster, work, seen)


def areas_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block of the survey. The usual number of returns comes from the blocks around."""
    occupancy, ground, domain = raster.inputs
    records = g.records(occupancy)
    for place, record in g.records(domain).items():
        near = [other for other in around(*place) if other in records]
        usual = None
        if g.trusted:
            usual = usual_returns((records[other]["returns"] for other in near), ENOUGH_RETURNS)
        given = sum(records[other]["water"] for other in near)
        if not record["filled"] or (usual is None and not given):
            continue
        times, median = usual or (1, None)
        work = FindAreas(
            name=raster.name, spec=g.coarse, block=g.coarse.block_at(*place, BLOCK_PIXELS),
            sources=Sources(occupancy, ground, domain), times=times, usual=median,
        )  # fmt: skip
        yield g.block_task(raster, work, _seen(g, raster.inputs, place))


def rims_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block near a candidate."""
    areas = raster.inputs[0]
    for place in _near_labels(g, areas):
        work = CountRims(**_on_areas(raster, g, place))
        yield g.block_task(raster, work, _seen(g, raster.inputs, place))


def plane_rims_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block near a plane that may be water."""
    planes = raster.inputs[0]
    evident, others = _likely_planes(g, planes)
    evident_at, others_at = (_by_place(g.areas(planes), names) for names in (evident, others))
    for place in near_places(g.coarse, {*evident_at, *others_at}):
        near = [
            tuple(sorted({name for other in around(*place) for name in at.get(other, ())}))
            for at in (evident_at, others_at)
        ]
        work = CountPlaneRims(**_on_areas(raster, g, place), evident=near[0], others=near[1])
        yield g.block_task(raster, work, _seen(g, raster.inputs, place))


def plane_sure_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block near a plane that is water."""
    rims, *inputs = raster.inputs
    kept = _kept_planes(g, inputs[0], rims)
    names_by_place = _by_place(g.areas(inputs[0]), kept)
    for place in near_places(g.coarse, names_by_place):
        names = sorted({name for other in around(*place) for name in names_by_place.get(other, ())})
        work = KeepPlanes(**_on_areas(raster, g, place), kept=tuple((name, kept[name]) for name in names))
        yield g.block_task(raster, work, _seen(g, inputs, place))


def sure_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block of a candidate that is water."""
    rims, *inputs = raster.inputs
    areas = inputs[0]
    kept = _kept(g, areas, rims)
    for place, names in _by_place(g.areas(areas), kept).items():
        work = KeepAreas(**_on_areas(raster, g, place), kept=tuple((name, kept[name]) for name in names))
        yield g.block_task(raster, work, [g.checksums(areas, names_of([place]))])


def crowns_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block near water, if laser pulses pass through crowns."""
    sure, planes, occupancy, ground = raster.inputs
    for place in _near_water(g, sure, planes) if g.trusted else []:
        block = g.coarse.block_at(*place, BLOCK_PIXELS)
        work = CrownsBlock(
            name=raster.name,
            spec=g.coarse,
            block=block,
            sure=(sure, planes),
            occupancy=occupancy,
            ground=ground,
            rule=g.rule,
        )
        cell = int(g.coarse.lattice.size) + 1
        near = g.plan.meta.bucket.among(g.coarse.block_bounds(block).pad(cell), g.labels)
        yield g.block_task(raster, work, [*_seen(g, raster.inputs, place), g.seen(near)])


def _near_water(g: GridContext, *sure: str) -> list[Place]:
    """Return the places of blocks with water, from rasters of its confidence, and of their neighbours."""
    records = [item for name in sure for item in g.records(name).items()]
    return near_places(g.coarse, {place for place, record in records if record["filled"]})


def cells_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block near water."""
    sure, planes, crowns, *sources = raster.inputs
    config = g.plan.config
    for place in _near_water(g, sure, planes):
        work = FinishWater(
            name=raster.name, spec=g.coarse, block=g.coarse.block_at(*place, BLOCK_PIXELS), sure=(sure, planes),
            crowns=crowns, sources=Sources(*sources), river_width_m=float(config.water_min_river_width),
            island_m2=float(config.water_min_island), decks=_decks_near(g, place),
        )  # fmt: skip
        yield g.block_task(raster, work, _seen(g, raster.inputs, place))


def _decks_near(g: GridContext, place: Place) -> tuple[tuple[int, ...], ...]:
    """Return the outlines of the removed bridges in a block and its neighbours."""
    block = g.coarse.block_at(*place, BLOCK_PIXELS)
    bounds = g.coarse.block_bounds(padded(block, BLOCK_PIXELS))
    rings = [deck[0] for deck in g.decks]
    boxes = [Bounds(min(ring[::2]), min(ring[1::2]), max(ring[::2]), max(ring[1::2])) for ring in rings]
    return tuple(ring for ring, box in zip(rings, boxes, strict=True) if bounds.overlaps(box))


def _on_areas(raster: RasterStep, g: GridContext, place: Place) -> dict[str, Any]:
    """Return the common arguments of tasks on candidates."""
    name, occupancy, ground, domain = raster.inputs[-4:]
    of_block = g.records(name).get(place)
    return {
        "name": raster.name,
        "spec": g.coarse,
        "block": g.coarse.block_at(*place, BLOCK_PIXELS),
        "sources": Sources(occupancy, ground, domain),
        "times": 1 if of_block is None else of_block["times"],
        "areas": name,
        "joins": g.areas(name).joins(around(*place)),
    }


def _seen(g: GridContext, rasters: Sequence[str], place: Place) -> list[Any]:
    """Return the checksums of a block and its neighbours for some rasters."""
    near = names_of(near_places(g.coarse, [place]))
    return [g.checksums(name, near) for name in rasters]


def _near_labels(g: GridContext, areas: str) -> list[Place]:
    labelled = [place for place, record in g.records(areas).items() if record["labels"]]
    return near_places(g.coarse, labelled)


def _by_place(joined: Joined, names: Iterable[Piece]) -> dict[Place, list[Piece]]:
    """Return the names of areas by the blocks in which they lie."""
    names_by_place: dict[Place, list[Piece]] = defaultdict(list)
    for name in sorted(names):
        for place in sorted({(piece.row, piece.col) for piece in joined.areas[name]}):
            names_by_place[place].append(name)
    return names_by_place


def _sizes(g: GridContext, areas: str) -> dict[Piece, tuple[int, ...]]:
    """Return the sums of the ``sizes`` of the pieces of each area."""
    return area_sums(g.areas(areas), g.records(areas))


def area_sums(joined: Joined, records: Mapping[Place, Mapping[str, Any]]) -> dict[Piece, tuple[int, ...]]:
    """Return the sums of ``sizes`` over the pieces of each area, by the name of the area."""
    sums = {}
    for name, pieces in joined.areas.items():
        parts = (records[p.row, p.col]["sizes"][p.label - 1] for p in pieces)
        sums[name] = tuple(map(sum, zip(*parts, strict=True)))
    return sums


def _kept(g: GridContext, areas: str, rims: str) -> dict[Piece, float]:
    """Return the candidates that are water, with confidences."""
    around_area = _rims(g, rims)
    verdicts = {
        name: judged(Size(*size), around_area.get(name, Rim())) for name, size in _sizes(g, areas).items()
    }
    return {name: sure for name, sure in verdicts.items() if sure is not None}


def _rims(g: GridContext, rims: str, which: int = 0) -> dict[Piece, Rim]:
    """Return the land around each area, added up over blocks, from the rim number ``which`` in the records."""
    rim_by_area: dict[Piece, Rim] = {}
    for record in g.records(rims).values():
        for name, *counts in record["rims"]:
            rim = Rim(*counts[min(which, len(counts) - 1)])
            rim_by_area[Piece(*name)] = rim_by_area.get(Piece(*name), Rim()).plus(rim)
    return rim_by_area


def _likely_planes(g: GridContext, planes: str) -> tuple[list[Piece], list[Piece]]:
    """Return the planes that may be water by themselves, and others that may lie next to them."""
    config, joined, records = g.plan.config, g.areas(planes), g.records(planes)
    min_m2 = float(min(config.water_min_lake, MIN_LENGTH * config.water_min_river_width**2))
    least = min_m2 / float(g.coarse_m) ** 2 / 2  # a plane lacks its shore, so half of the area is enough
    sizes = {name: Plane(*size) for name, size in area_sums(joined, records).items() if size[0] >= least}
    boxes = {name: _box(joined.areas[name], records) for name in sizes}
    evident = [name for name, plane in sizes.items() if plane.is_evident]
    reach_cells = DAM_M / float(g.coarse_m) + SHORE_CELLS
    others = [
        name for name in sizes.keys() - set(evident)
        if any(_are_near(boxes[name], boxes[other], reach_cells) for other in evident)
    ]  # fmt: skip
    return sorted(evident), sorted(others)


def _box(pieces: Iterable[Piece], records: Mapping[Place, Mapping[str, Any]]) -> tuple[int, int, int, int]:
    """Return the first row and column, and the last row and column plus 1, of an area."""
    boxes = [records[p.row, p.col]["boxes"][p.label - 1] for p in pieces]
    top, left, bottom, right = zip(*boxes, strict=True)
    return min(top), min(left), max(bottom), max(right)


def _are_near(one: Sequence[int], other: Sequence[int], reach: float) -> bool:
    apart = (max(one[i], other[i]) - min(one[i + 2], other[i + 2]) for i in (0, 1))
    return all(gap <= reach for gap in apart)


def _kept_planes(g: GridContext, planes: str, rims: str) -> dict[Piece, float]:
    """Return the planes that are water, with confidences: evident planes, and planes next to them."""
    evident, others = _likely_planes(g, planes)
    alone, without_others = ({n: judged(Size(), rim) for n, rim in _rims(g, rims, i).items()} for i in (0, 1))
    beside: dict[Piece, set[Piece]] = defaultdict(set)
    for record in g.records(rims).values():
        for name, other in record["beside"]:
            beside[Piece(*name)].add(Piece(*other))
    held = {name: sure for name in others if (sure := alone.get(name))}
    kept = {name: sure for name in evident if (sure := alone.get(name))}
    # Two neighbouring planes, one above a dam and one below, may both be water if the other does not count as land.
    lower = {other for name in held for other in beside[name]}
    kept |= {name: sure for name in evident if name in lower and (sure := without_others.get(name))}
    return kept | {name: sure for name, sure in held.items() if beside[name] & kept.keys()}
