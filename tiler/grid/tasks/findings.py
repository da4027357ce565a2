"""Search for flaws: places above all returns, roofs, crowns, voids, implausible results; their entries in run.json."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from fractions import Fraction
from itertools import chain
from typing import Any

import numpy as np
import shapely

from ptd.arrays import Indices, Int64
from ptd.matched.crowns import Crowns
from ptd.matched.passes import CanopyPass
from tiler.config import VOID_CANOPY
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.raster import BLOCK_PIXELS, Block, RasterSpec
from tiler.core.records import BlockRecord, digest_of
from tiler.core.results import (
    AbovePlace,
    AboveResult,
    Implausible,
    Rings,
    VoidResult,
    VoidsResult,
)
from tiler.core.units import length_text, small_area_text
from tiler.core.words import counted
from tiler.errors import CorruptStoreError, ProcessingError
from tiler.grid.coarse import join_pieces, touching_cells
from tiler.grid.flaws import (
    ABOVE_M,
    BELOW_M,
    CELLS_PER_BLOCK,
    MIN_PLACE_M2,
    Advice,
    crown_advice,
    find_crowns,
    find_roofs,
    min_pixels,
)
from tiler.grid.steps import Counts
from tiler.grid.tasks.correct import report_edit_holes
from tiler.grid.tasks.gridding import GridContext
from tiler.grid.voids import CELL_PIXELS
from tiler.observe.events import Warned
from tiler.plan import KEEP
from tiler.runs.found import Labelled, checksums
from tiler.runs.job import Job
from tiler.schedule import Task, calling
from tiler.schedule.worker import compute
from tiler.store import Commits

MAX_LISTED = 1000


CROWN_BLOCKS = 16
"""One task searches for crowns in this many blocks. A block takes at most half a second."""


def advise(
    job: Job, labelled: Labelled, spec: RasterSpec, made: Commits, waters: str | None
) -> None:
    """Warn about roofs in the terrain, and about crowns in the terrain of a photogrammetric cloud.

    ``waters`` is the key of the bodies of water in the store, if there are any.
    """
    building = job.plan.method.parameters.get("max_building_size_m")
    # A filter that searches for canopies reports crowns itself.
    checks_crowns = labelled.matched and CanopyPass.name not in labelled.statistics
    if not (building or checks_crowns):
        return
    inputs = [building, checks_crowns, waters, digest_of(checksums(made))]
    advice_state = job.store.get_state("advice")
    if not advice_state or advice_state.get("asked") != inputs:
        filled = tuple(
            key for key, (_, stored) in made.items() if BlockRecord.of(stored).filled
        )
        found = [_roofs(job, spec, filled, waters) if building is not None else None]
        found.append(_crowns(job, spec, filled) if checks_crowns else None)
        advices = [advice for advice in found if advice is not None]
        texts = [advice.text for advice in advices]
        positions = [[advice.x, advice.y] for advice in advices]
        advice_state = {"asked": inputs, "texts": texts, "at": positions}
        job.store.put_state("advice", advice_state)
    job.results.advice, job.results.advice_at = advice_state["texts"], advice_state["at"]
    for line in advice_state["texts"]:
        job.listener(Warned(line))


def _roofs(
    job: Job, spec: RasterSpec, filled: tuple[str, ...], waters: str | None
) -> Advice | None:
    parameters = job.plan.method.parameters
    call = calling(
        find_roofs,
        spec=spec,
        filled=filled,
        building_m=parameters["max_building_size_m"],
        roof_m=parameters.get("roof_size_m"),
        waters=waters,
    )
    (counts,) = _run_tasks(job, [Task.of("advice", "roofs", call)])
    advice = counts["advice"]
    return None if advice is None else Advice(*advice)


def _crowns(job: Job, spec: RasterSpec, filled: tuple[str, ...]) -> Advice | None:
    tasks = []
    for i in range(0, len(filled), CROWN_BLOCKS):
        call = calling(find_crowns, spec=spec, names=filled[i : i + CROWN_BLOCKS])
        tasks.append(Task.of("advice", f"crowns{i:06d}", call))
    parts = [Crowns(counts["n_tested"], counts["found"]) for counts in _run_tasks(job, tasks)]
    return crown_advice(parts, spec)


def _run_tasks(job: Job, tasks: list[Task]) -> list[Counts]:
    """Run tasks on workers, and return their counts in the order of the tasks."""
    records = {}
    for outcome in job.executors.choose().run(compute, job.store.url, tasks):
        if outcome.again:
            continue
        if outcome.damaged:
            damaged_text = ", ".join(outcome.damaged)
            raise CorruptStoreError(
                f"{job.store.url}: {damaged_text}: damaged or missing; run again",
                outcome.damaged,
            )
        if outcome.record is None:
            raise ProcessingError(
                f"the search for flaws in the terrain failed: {outcome.error}"
            )
        records[outcome.task.key] = outcome.record
    return [records[task.key] for task in tasks]


"""run.json lists at most this many places, the worst ones."""


def report_above(job: Job, spec: RasterSpec, of_blocks: Mapping[Block, Counts]) -> None:
    """Add to run.json the places where the terrain lies above all returns, and note them."""
    places = places_of(of_blocks, spec, job.plan.grid.resolution**2)
    pixels = sum(counts["wrong"] for counts in of_blocks.values())
    job.results.above_returns = AboveResult(pixels, len(places), places[:MAX_LISTED])
    if places:
        job.note(_note(job, places))


def places_of(
    of_blocks: Mapping[Block, Counts], spec: RasterSpec, pixel_m2: Fraction
) -> list[AbovePlace]:
    """Join the places of blocks across their sides, leave out small places, and sort by height.

    Parameters
    ----------
    of_blocks : mapping
        Block -> counts of `tiler.grid.flaws.above`.
    spec : RasterSpec
    pixel_m2 : Fraction
        Area of a pixel.
    """
    found = {(block.row, block.col): counts for block, counts in of_blocks.items()}
    least, places = min_pixels(pixel_m2), []
    for pieces in join_pieces(found, corners=True).areas.values():
        parts = [found[piece.row, piece.col]["places"][piece.label - 1] for piece in pieces]
        n_pixels, spans, heights = zip(*parts, strict=True)
        pixels = int(sum(n_pixels))
        if pixels < least:
            continue
        row, first, last = np.array(list(chain.from_iterable(spans)), np.int64).T
        bounds = bounds_of(spec, (row.min(), first.min()), (row.max(), last.max()))
        rings = rings_around(spec, row, first, row, last)
        places.append(AbovePlace(pixels, bounds, float(pixels * pixel_m2), max(heights), rings))
    return sorted(places, key=lambda place: (-place.height_m, -place.pixels, place.bounds))


def _note(job: Job, places: list[AbovePlace]) -> str:
    pixels = sum(place.pixels for place in places)
    units, worst = job.plan.frame.units, places[0]
    west, south, east, north = worst.bounds
    return (
        f"in {counted(pixels, 'pixel')} all returns lie more than {length_text(ABOVE_M, units.vertical)} below the "
        f"terrain, in {counted(len(places), 'place')} of at least "
        f"{small_area_text(float(MIN_PLACE_M2), units.horizontal)}: the terrain is too high there, or the returns are "
        f"noise; worst at x {(west + east) / 2:.0f}, y {(south + north) / 2:.0f}, by "
        f"{length_text(round(worst.height_m, 1), units.vertical)}"
    )


MIN_GROUND = 0.01
"""Minimum share of ground among the points, and of pixels with a return near the terrain."""
ENOUGH_NEAR = 0.1
"""Share of pixels with a return near the terrain from which few ground points are right, as in
dense scans of forests."""
MAX_VOID = 0.5
"""Share of the survey from which voids are implausible."""
MAX_BELOW = 0.98
"""Share of the pixels of a square in which the terrain may lie below all returns."""
SQUARE_M = 256.0
"""Least side of a square. The widest roof that is removed by default is 200 m wide."""
MIN_SEEN = 1 / 3
"""Least share of pixels with returns in a square, so that a roof at the border of the survey is not a square."""

Square = tuple[int, int]


def report_implausible(job: Job, spec: RasterSpec, above: Iterable[Counts]) -> None:
    """Warn about results that cannot be true, and add them to run.json."""
    if vars(job.results).get("implausible"):  # An empty terrain explains all else.
        return
    job.results.implausible = []
    # A canopy or a failed tile explains them, and has its own warning.
    if job.record.failed or "canopy_doubts" in vars(job.results):
        return
    pixel_m = float(job.plan.grid.resolution)
    job.results.implausible = [*_low_terrain(job, spec, above, pixel_m), *_void(job)]
    for result in job.results.implausible:
        job.listener(Warned(f"{result.why}: {result.remedy}"))


def _low_terrain(
    job: Job, spec: RasterSpec, above: Iterable[Counts], pixel_m: float
) -> Iterator[Implausible]:
    """Yield terrain far below the returns: of the whole survey, or of the squares in which it is."""
    cell_pixels = BLOCK_PIXELS // CELLS_PER_BLOCK
    side = max(math.ceil(SQUARE_M / (cell_pixels * pixel_m)), 1) * cell_pixels
    seen, below = Counter[Square](), Counter[Square]()
    for counts in above:
        for row, col, n_seen, n_below in counts["cells"]:
            seen[row // side, col // side] += n_seen
            below[row // side, col // side] += n_below
    near, share = 1 - below.total() / max(seen.total(), 1), _ground_share(job)
    height = length_text(BELOW_M, job.plan.frame.units.vertical)
    if seen and (near < MIN_GROUND or (share < MIN_GROUND and near < ENOUGH_NEAR)):
        why = (
            f"{share:.2%} of the points are ground, and all returns lie more than {height} above the terrain in "
            f"{1 - near:.1%} of the pixels"
        )
        yield Implausible("too little ground", why, _remedy(job), None)
        return
    wrong = [
        square
        for square, n in seen.items()
        if n >= MIN_SEEN * side**2 and below[square] >= MAX_BELOW * n
    ]
    if wrong:
        row, col = min(wrong, key=lambda square: (-below[square], square))
        bounds = spec.block_bounds(Block(row * side, col * side, side, side))
        length = length_text(side * pixel_m, job.plan.frame.units.horizontal)
        why = (
            f"nearly all returns lie more than {height} above the terrain, in {len(wrong)} of {len(seen)} squares of "
            f"{length}"
        )
        edges = [edge / COUNTS_PER_UNIT for edge in bounds.to_json()]
        yield Implausible("terrain below all returns", why, _remedy(job), edges)


def _ground_share(job: Job) -> float:
    """Return the share of ground among the points that a filter or the input classified."""
    config, results = job.plan.config, job.results
    if config.method != KEEP:
        return results.filter.ground / max(results.filter.points - results.filter.kept, 1)
    counts = results.classes.input
    ground = sum(counts.get(str(code), 0) for code in config.ground_classes)
    return ground / max(sum(counts.values()), 1)


def _remedy(job: Job) -> str:
    method = job.plan.config.method
    if method == KEEP:
        return "the ground classes of the input are incomplete or wrong; use --method auto"
    if method != "auto":
        return f"method {method} took low points for ground, or hills for objects; use --method auto"
    return f"if hills are cut off there, use {_smaller_objects(job)}, or --edits with the action ground"


def _smaller_objects(job: Job) -> str:
    parameters = job.plan.method.parameters
    sizes = (
        f"{n} (it is {parameters[f'{n}_m']:g} m)" for n in ("roof_size", "max_building_size")
    )
    return f"a lower --set {' or '.join(sizes)}"


def _void(job: Job) -> Iterator[Implausible]:
    """Yield voids in half of the survey, unless the user asked for voids under canopy."""
    config, voids = job.plan.config, vars(job.results).get("voids")
    if voids is None or config.canopy == VOID_CANOPY:
        return
    # A terrain without any height has its own warning.
    share = voids.pixels / max(voids.surveyed_pixels, 1)
    if MAX_VOID <= share < 1:
        edge = length_text(config.max_edge, job.plan.frame.units.horizontal)
        why = (
            f"{share:.0%} of the survey has no height, because its ground points are farther apart than --max-edge "
            f"{edge}"
        )
        remedy = "use --voids fill, or a larger --max-edge"
        if config.method == "auto":
            remedy += f"; if hills are void, use {_smaller_objects(job)}"
        yield Implausible("mostly void survey", why, remedy, None)


"""run.json lists at most this many voids, the largest ones."""
MIN_BARE_CELLS = 2
"""Least side in cells of the survey of a square with the area of a place without returns."""


def report_voids(job: Job, gridding: GridContext, outlined: Commits) -> None:
    """Add to run.json the voids of the delivered terrain, places without returns, and the holes inside each edit."""
    of_blocks, spec = [counts for _, counts in outlined.values()], gridding.spec
    hole_pixels = Counter[str]()
    for counts in of_blocks:
        for edit, n_pixels in counts["edit_holes"]:
            hole_pixels[edit] += n_pixels
    report_edit_holes(job, hole_pixels)
    cells = chain.from_iterable(counts["holes"] for counts in of_blocks)
    pixel_m2 = float(job.plan.grid.resolution) ** 2
    voids = voids_of(cells, spec, pixel_m2)
    job.results.voids = VoidsResult(
        surveyed_pixels=sum(counts["surveyed"] for counts in of_blocks),
        pixels=sum(void.pixels for void in voids),
        asked_pixels=sum(counts["voided"] for counts in of_blocks),
        number=len(voids),
        largest=voids[:MAX_LISTED],
    )
    bare = chain.from_iterable(counts["bare"] for counts in of_blocks)
    # What water or the border leaves of a place may be smaller.
    min_m2 = (MIN_BARE_CELLS * float(gridding.coarse_m)) ** 2
    places = [p for p in voids_of(bare, spec, pixel_m2) if p.area_m2 >= min_m2]
    job.results.without_returns = places[:MAX_LISTED]


def voids_of(cells: Iterable[list[int]], spec: RasterSpec, pixel_m2: float) -> list[VoidResult]:
    """Merge touching cells with holes (see `tiler.grid.voids.hole_cells`) into voids, the largest first.

    Those that run.json lists have rings around the holes of each cell.
    """
    table = np.array(list(cells), np.int64).reshape(-1, 8)
    if not len(table):
        return []
    n_holes, first_pixel, last_pixel = table[:, 0], table[:, 1:3], table[:, 3:5]
    cell_places = list(map(tuple, (first_pixel // CELL_PIXELS).tolist()))
    groups = touching_cells(cell_places)
    n_voids = len(groups)
    void_at = {place: number for number, group in enumerate(groups) for place in group}
    void_of_cell = np.array([void_at[place] for place in cell_places])
    pixels = np.bincount(void_of_cell, n_holes, n_voids).astype(np.int64)
    at_border = np.bincount(void_of_cell, table[:, 5], n_voids) > 0
    first = np.full((n_voids, 2), np.iinfo(np.int64).max)
    last = np.zeros((n_voids, 2), np.int64)
    np.minimum.at(first, void_of_cell, first_pixel)
    np.maximum.at(last, void_of_cell, last_pixel)
    at = table[_central_cells(void_of_cell, n_holes, table[:, 6:]), 6:]
    order = np.lexsort((first[:, 1], first[:, 0], -pixels))
    return [
        VoidResult(
            int(pixels[i]),
            bounds_of(spec, first[i], last[i]),
            int(pixels[i]) * pixel_m2,
            bool(at_border[i]),
            _centre(bounds_of(spec, at[i], at[i])),
            rings_around(spec, *table[void_of_cell == i, 1:5].T) if rank < MAX_LISTED else None,
        )
        for rank, i in enumerate(order)
    ]


def _central_cells(void_of_cell: Any, n_holes: Any, positions: Int64) -> Indices:
    """Return for each void its cell with most holes, of several the one next to their mean."""
    most = np.zeros(void_of_cell.max() + 1, np.int64)
    np.maximum.at(most, void_of_cell, n_holes)
    is_full = n_holes == most[void_of_cell]
    n_full = np.bincount(void_of_cell, is_full)
    means = np.stack(
        [np.bincount(void_of_cell, is_full * values) / n_full for values in positions.T]
    )
    from_mean = np.hypot(*(positions.T - means[:, void_of_cell]))
    best_first = np.lexsort(
        (positions[:, 1], positions[:, 0], from_mean, ~is_full, void_of_cell)
    )
    return best_first[np.searchsorted(void_of_cell[best_first], np.arange(len(most)))]


def _centre(bounds: list[float]) -> list[float]:
    west, south, east, north = bounds
    return [(west + east) / 2, (south + north) / 2]


def bounds_of(spec: RasterSpec, first: Any, last: Any) -> list[float]:
    """Return the edges of the pixels from the first to the last row and column, in units of the CRS."""
    height, width = (int(last[i] - first[i] + 1) for i in (0, 1))
    bounds = spec.block_bounds(Block(int(first[0]), int(first[1]), height, width))
    return [edge / COUNTS_PER_UNIT for edge in bounds.to_json()]


def rings_around(spec: RasterSpec, top: Any, left: Any, bottom: Any, right: Any) -> Rings:
    """Return the closed rings around rectangles of pixels (int64, their first and last rows and columns)."""
    size = float(spec.lattice.size / COUNTS_PER_UNIT)
    east, north = (spec.west + right + 1) * size, (spec.north - top) * size
    west, south = (spec.west + left) * size, (spec.north - bottom - 1) * size
    shape = shapely.normalize(shapely.union_all(shapely.box(west, south, east, north)))
    rings = shapely.get_rings(shapely.get_parts(shapely.simplify(shape, 0.0)))
    return [np.round(shapely.get_coordinates(ring), 3).ravel().tolist() for ring in rings]
