"""Sheets into which products are divided."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from math import floor
from typing import Any

import numpy as np

from tiler.core.area import Area, AreaIndex
from tiler.core.drawn_sheets import StoredAreas
from tiler.core.file_names import DEFAULT, product_names, sheet_name
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds, Cell
from tiler.core.products import MODELS
from tiler.core.raster import BLOCK_PIXELS, RasterSpec
from tiler.core.records import BlockRecord, digest_of
from tiler.core.units import area_text
from tiler.core.words import counted
from tiler.errors import ProcessingError
from tiler.export.polygons import find_drawn_sheets, find_sheets
from tiler.observe.events import Warned
from tiler.plan.drawn_sheets import validate_on_clouds
from tiler.runs.found import Gridded, Sheet, final_raster
from tiler.runs.job import Job
from tiler.runs.stage_runner import run_stage
from tiler.schedule import Task, calling

STAGE = "sheets"


def cut(job: Job, context: Gridded) -> list[Sheet]:
    """Return the sheets of a run, or an empty list if its products are not divided.

    Raise InputError if the terrain has heights, but none in the polygons of the user.
    """
    if context.plan.config.sheets is None:
        return []
    tasks = list(height_tasks(context))
    made = run_stage(job, STAGE, tasks) if tasks else {}
    if len(made) < len(tasks):
        raise ProcessingError(
            f"--sheets: the search for heights failed; the first block: {job.record.first_error(STAGE)}"
        )
    stored = [record for _, record in made.values()]
    chosen = _drawn if context.plan.inputs.sheets else _in_grid
    filled, every = chosen(context, stored)
    if tasks and not filled and not (every and context.plan.config.empty_sheets):
        validate_on_clouds(context.plan.config, (), context.assembled.bounds)
    _warn_outside(job, context, stored)
    if context.plan.config.empty_sheets:
        return every
    if len(every) > len(filled):
        number = len(every) - len(filled)
        written = "is not written" if number == 1 else "are not written"
        job.note(f"{counted(number, 'sheet')} without a height {written} (--empty-sheets)")
    return filled


def _in_grid(
    context: Gridded, stored: Iterable[Mapping[str, Any]]
) -> tuple[list[Sheet], list[Sheet]]:
    """Return the sheets of the grid with heights, and those with heights or points."""
    high = {Cell(*cell) for record in stored for cell in record["sheets"]}
    return sheets(context, high), sheets(context, high | set(with_points(context)))


def _drawn(
    context: Gridded, stored: Iterable[Mapping[str, Any]]
) -> tuple[list[Sheet], list[Sheet]]:
    """Return the drawn sheets with heights, and those with heights or points, in the order of their file."""
    drawn, buckets = context.plan.inputs.sheets, with_points_drawn(context)
    high = {key for record in stored for key in record["sheets"]}
    every = [
        Sheet(
            RasterSpec.enclosing(context.spec.lattice, sheet.area.bounds),
            buckets.get(number, []),
            sheet,
        )
        for number, sheet in enumerate(drawn)
        if sheet.area.key not in sheet.earlier and (number in buckets or sheet.area.key in high)
    ]
    return [s for s in every if s.drawn is not None and s.drawn.area.key in high], every


def _warn_outside(job: Job, context: Gridded, stored: Iterable[Mapping[str, Any]]) -> None:
    """Warn if pixels with heights are in none of the drawn sheets."""
    outside = sum(record.get("outside", 0) for record in stored)
    if outside:
        size = float(context.spec.lattice.size * context.plan.frame.metres_xy)
        where = area_text(outside * size**2, context.plan.frame.units.horizontal)
        job.listener(
            Warned(
                f"{context.plan.config.sheets}: {outside:,} pixels with heights ({where}) lie in no sheet, so no file "
                "has them; add polygons there if they should be delivered"
            )
        )


def height_tasks(context: Gridded) -> Iterator[Task]:
    """Yield one task per block of the models that has a height."""
    rasters = tuple(
        name
        for name in (final_raster(model, context.plan.config) for model in MODELS)
        if name in context.made
    )
    area, index = context.plan.inputs.area_key, _index(context)
    keys: set[str] = set()
    for name in rasters:
        keys.update(
            key
            for key, (_, stored) in context.made[name].items()
            if BlockRecord.of(stored).filled
        )
    for key in sorted(keys):
        block = context.spec.block_named(key, BLOCK_PIXELS)
        where: dict[str, Any] = {
            "rasters": rasters,
            "spec": context.spec,
            "block": block,
            "area": area,
        }
        if index is None:
            width, height = _pixels(context)
            call = calling(find_sheets, **where, width=width, height=height)
        else:
            near = index.touching(context.spec.block_bounds(block))
            keys_near = tuple(context.plan.inputs.sheets[number].area.key for number in near)
            stored_areas = StoredAreas(keys_near, context.drawn)
            call = calling(find_drawn_sheets, **where, sheets=stored_areas)
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
    own_name = "" if sheet.drawn is None else sheet.drawn.name
    return sheet_name(config.sheet_template, name, sheet.spec.edges, own_name)


def key_of(product: str, sheet: Sheet) -> str:
    """Return the key of the task of a sheet, without the ending of its file.

    It does not depend on the template, which may give sheets of several products the same name
    or contain characters that are not allowed in the store.
    """
    if sheet.drawn is not None:
        return f"{product}_{digest_of(sheet.drawn.name)}"
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


def with_points_drawn(context: Gridded) -> dict[int, list[Cell]]:
    """Return the buckets of each drawn sheet in the raster and the area, by its number from 0."""
    area, whole, index = context.plan.inputs.area, context.spec.bounds, _index(context)
    buckets: dict[int, list[Cell]] = defaultdict(list)
    for bucket, record in context.assembled.records.items():
        if record.bounds and index is not None:
            bounds = Bounds.from_json(record.bounds).intersection(whole)
            if not bounds.empty and (area is None or area.touches(bounds)):
                for number in index.touching(bounds):
                    buckets[number].append(bucket)
    return buckets


def sheet_finder(sheets: Sequence[Sheet]) -> Callable[[float, float], Sheet | None]:
    """Return a function that finds the sheet at x and y in units of the CRS, or None if there is no sheet."""
    areas = [
        Area.rectangle(sheet.spec.bounds) if sheet.drawn is None else sheet.drawn.area
        for sheet in sheets
    ]
    index = AreaIndex(areas)

    def find(x: float, y: float) -> Sheet | None:
        column, row = floor(x * COUNTS_PER_UNIT), floor(y * COUNTS_PER_UNIT)
        at = np.array([column]), np.array([row])
        near = index.overlapping(Bounds(column, row, column + 1, row + 1))
        return next((sheets[i] for i in near if areas[i].inside(*at)[0]), None)

    return find


def _index(context: Gridded) -> AreaIndex | None:
    """Return the index of the drawn sheets, or None if the user drew none."""
    drawn = context.plan.inputs.sheets
    return AreaIndex([sheet.area for sheet in drawn]) if drawn else None


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
    pixel, sides = context.spec.lattice.size, context.plan.config.sheets
    width, height = (
        int(context.plan.frame.counts(Fraction(side)) / pixel) for side in sides or ()
    )
    return width, height
