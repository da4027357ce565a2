"""Sheets into which products are divided."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from fractions import Fraction

from tiler.core.file_names import DEFAULT, product_names, sheet_name
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds, Cell, Lattice
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
    side, area = _pixels(context), context.plan.inputs.area_key
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
            find_sheets, rasters=rasters, spec=context.spec, block=block, side=side, area=area
        )
        seen = [context.checksums(name, [key]) for name in rasters]
        pixels, bounds = block.height * block.width, context.spec.block_bounds(block)
        yield Task.of(STAGE, key, call, seen, pixels=pixels, bounds=bounds)


def sheets(context: Gridded, cells: Iterable[Cell]) -> list[Sheet]:
    """Return the sheets of these cells of the lattice of sheets, which is anchored at CRS 0."""
    lattice, side = _lattice(context), _pixels(context)
    buckets, sheets_of_cells = with_points(context), []
    for cell in sorted(cells):
        corner = (
            float(cell.ix * lattice.size / COUNTS_PER_UNIT),
            float(cell.iy * lattice.size / COUNTS_PER_UNIT),
        )
        spec = RasterSpec(
            context.spec.lattice, cell.ix * side, (cell.iy + 1) * side, side, side
        )
        sheets_of_cells.append(Sheet(corner, spec, buckets.get(cell, [])))
    return sheets_of_cells


def name_of(context: Gridded, product: str, sheet: Sheet) -> str:
    """Return the name of a product's file for a sheet, without its ending."""
    config, side = context.plan.config, float(_lattice(context).size / COUNTS_PER_UNIT)
    name = product_names(config.product_name).get(product, product)
    return sheet_name(config.sheet_name, name, *sheet.corner, side)


def key_of(product: str, sheet: Sheet) -> str:
    """Return the key of the task of a sheet, without the ending of its file.

    It does not depend on the template, which may give sheets of several products the same name
    or contain characters that are not allowed in the store.
    """
    return sheet_name(DEFAULT, product, *sheet.corner, 0.0)


def with_points(context: Gridded) -> dict[Cell, list[Cell]]:
    """Return the buckets of each sheet in the raster and the area, by the bounds of their points."""
    lattice, area = _lattice(context), context.plan.inputs.area
    whole = context.spec.block_bounds(
        context.spec.block_at(0, 0, max(context.spec.height, context.spec.width))
    )
    buckets: dict[Cell, list[Cell]] = defaultdict(list)
    for bucket, record in context.assembled.records.items():
        if record.bounds:
            for cell in lattice.cells(Bounds.from_json(record.bounds).intersection(whole)):
                buckets[cell].append(bucket)
    if area is None:
        return buckets
    return {
        cell: cell_buckets
        for cell, cell_buckets in buckets.items()
        if area.touches(lattice.bounds(cell))
    }


def _lattice(context: Gridded) -> Lattice:
    """Return the lattice of the sheets."""
    return Lattice(context.plan.frame.counts(context.plan.config.sheets or Fraction(0)))


def _pixels(context: Gridded) -> int:
    """Return the side of a sheet in pixels."""
    return int(_lattice(context).size / context.spec.lattice.size)
