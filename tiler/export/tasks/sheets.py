"""Sheets into which products are divided."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from math import floor

from tiler.core.area import Area, AreaIndex
from tiler.core.file_names import DEFAULT, product_names, sheet_name
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds, Cell
from tiler.core.products import MODELS
from tiler.core.raster import BLOCK_PIXELS, RasterSpec
from tiler.core.records import BlockRecord
from tiler.core.words import counted
from tiler.errors import ProcessingError
from tiler.export.polygons import find_sheets
from tiler.runs.found import Gridded, Sheet, final_raster
from tiler.runs.job import Job
from tiler.runs.stage_runner import run_stage
from tiler.schedule import Task, calling

STAGE = "sheets"


def cut(job: Job, context: Gridded) -> list[Sheet]:
    """Return the sheets of a run, or an empty list if its products are not divided."""
    if context.plan.config.sheets is None:
        return []
    tasks = list(height_tasks(context))
    made = run_stage(job, STAGE, tasks) if tasks else {}
    if len(made) < len(tasks):
        raise ProcessingError(
            f"--sheets: the search for heights failed; the first block: {job.record.first_error(STAGE)}"
        )
    high: set[Cell] = set()
    for _, stored in made.values():
        high.update(Cell(*cell) for cell in stored["sheets"])
    every = high | set(with_points(context))
    if len(every) > len(high) and not context.plan.config.empty_sheets:
        number = len(every) - len(high)
        written = "is not written" if number == 1 else "are not written"
        job.note(f"{counted(number, 'sheet')} without a height {written} (--empty-sheets)")
    return sheets(context, every if context.plan.config.empty_sheets else high)


def height_tasks(context: Gridded) -> Iterator[Task]:
    """Yield one task per block of the models that has a height."""
    rasters = tuple(
        name
        for name in (final_raster(model, context.plan.config) for model in MODELS)
        if name in context.made
    )
    width, height = _pixels(context)
    area = context.plan.inputs.area_key
    keys: set[str] = set()
    for name in rasters:
        keys.update(
            key
            for key, (_, stored) in context.made[name].items()
            if BlockRecord.of(stored).filled
        )
    for key in sorted(keys):
        block = context.spec.block_named(key, BLOCK_PIXELS)
        call = calling(
            find_sheets,
            rasters=rasters,
            spec=context.spec,
            block=block,
            width=width,
            height=height,
            area=area,
        )
        seen = [context.checksums(name, [key]) for name in rasters]
        pixels, bounds = block.height * block.width, context.spec.block_bounds(block)
        yield Task.of(STAGE, key, call, seen, pixels=pixels, bounds=bounds)


def sheets(context: Gridded, cells: Iterable[Cell]) -> list[Sheet]:
    """Return the sheets at these positions in the grid of sheets, which is anchored at CRS 0."""
    buckets = with_points(context)
    return [Sheet(_spec(context, cell), buckets.get(cell, [])) for cell in sorted(cells)]


def name_of(context: Gridded, product: str, sheet: Sheet) -> str:
    """Return the name of a product's file for a sheet, without its ending."""
    config = context.plan.config
    name = product_names(config.product_name).get(product, product)
    return sheet_name(config.sheet_name, name, sheet.spec.edges)


def key_of(product: str, sheet: Sheet) -> str:
    """Return the key of the task of a sheet, without the ending of its file.

    It does not depend on the template, which may give sheets of several products the same name
    or contain characters that are not allowed in the store.
    """
    return sheet_name(DEFAULT, product, sheet.spec.edges)


def with_points(context: Gridded) -> dict[Cell, list[Cell]]:
    """Return the buckets of each sheet in the raster and the area, by the bounds of their points."""
    area, whole = context.plan.inputs.area, context.spec.bounds
    buckets: dict[Cell, list[Cell]] = defaultdict(list)
    for bucket, record in context.assembled.records.items():
        if record.bounds:
            for cell in _cells(context, Bounds.from_json(record.bounds).intersection(whole)):
                buckets[cell].append(bucket)
    if area is None:
        return buckets
    return {
        cell: cell_buckets
        for cell, cell_buckets in buckets.items()
        if area.touches(_spec(context, cell).bounds)
    }


def sheet_finder(sheets: Sequence[Sheet]) -> Callable[[float, float], Sheet | None]:
    """Return a function that finds the sheet at x and y in units of the CRS, or None if there is no sheet."""
    index = AreaIndex([Area.rectangle(sheet.spec.bounds) for sheet in sheets])

    def find(x: float, y: float) -> Sheet | None:
        column, row = floor(x * COUNTS_PER_UNIT), floor(y * COUNTS_PER_UNIT)
        near = index.overlapping(Bounds(column, row, column + 1, row + 1))
        return sheets[near[0]] if near else None

    return find


def _cells(context: Gridded, bounds: Bounds) -> Iterator[Cell]:
    """Yield the positions of the sheets that overlap ``bounds``, row by row from the south-west."""
    if bounds.empty:
        return
    index, (width, height) = context.spec.lattice.index_of, _pixels(context)
    for iy in range(index(bounds.y0) // height, index(bounds.y1 - 1) // height + 1):
        for ix in range(index(bounds.x0) // width, index(bounds.x1 - 1) // width + 1):
            yield Cell(ix, iy)


def _spec(context: Gridded, cell: Cell) -> RasterSpec:
    """Return the pixels of the sheet at a position in the grid of sheets."""
    width, height = _pixels(context)
    west, north = cell.ix * width, (cell.iy + 1) * height
    return RasterSpec(context.spec.lattice, west, north, height, width)


def _pixels(context: Gridded) -> tuple[int, int]:
    """Return the width and height of a sheet in pixels."""
    pixel, sides = context.spec.lattice.size, context.plan.config.sheets or ()
    width, height = (int(context.plan.frame.counts(side) / pixel) for side in sides)
    return width, height
