"""The tasks that write the files of a run: rasters (one COG each, or sheets and a VRT over them), classified clouds."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

from tiler.core.crs import vertical_name
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.products import NODATA, PRODUCTS
from tiler.core.raster import BLOCK_PIXELS, RasterSpec
from tiler.core.sheet_names import refuse_alike, sheet_name
from tiler.export import (
    WriteClassified,
    WriteCog,
    WriteLegend,
    WriteMosaic,
    WriteSheetIndex,
    write_classified,
    write_cog,
    write_legend,
    write_mosaic,
    write_sheet_index,
)
from tiler.export.work import SheetFile
from tiler.filter import LABELS
from tiler.ingest import SourceInfo, claimed_bounds, window_pieces
from tiler.io.locations import is_url, joined, location
from tiler.io.result_folder import CLASSIFIED, LEGEND, SHEETS, mosaic_file, raster_file
from tiler.plan import PIECE_POINTS, Plan, chunks_of
from tiler.schedule import Task, digest_of
from tiler.stages.gridding import Gridding
from tiler.stages.ingest_tasks import Source, by_source
from tiler.stages.raster_table import MODELS, final, raster_table
from tiler.store import Commits, KeptPiece
from tiler.version import __version__

Inputs = Mapping[Cell, Collection[str]]
"""Bucket -> digests of the sources that have points in it."""


def inputs_of(sources: Iterable[Source], spooled: Commits) -> Inputs:
    """The inputs of each bucket, from the commits of the pieces."""
    found: dict[Cell, set[str]] = defaultdict(set)
    records = by_source(spooled)
    for source in sources:
        for record in records.get(source.name, ()):
            for ix, iy, _ in record["buckets"]:
                found[Cell(ix, iy)].add(source.content)
    return found


@dataclass(frozen=True)
class Sheet:
    """One of the squares into which the products are cut: its south-west corner, its pixels, its buckets."""

    corner: tuple[float, float]
    spec: RasterSpec
    cells: list[Cell]


def name_of(g: Gridding, product: str, sheet: Sheet) -> str:
    """The name of a product's file of a sheet, without its ending."""
    return sheet_name(g.plan.config.sheet_name, product, *sheet.corner, _side(g))


def cog_tasks(g: Gridding, inputs: Inputs, whole_inputs: str, out: str) -> Iterator[Task]:
    """One task for each raster file.

    The tag of a sheet names the inputs that have points in it, and its digest the blocks that it is made of: another
    input makes new sheets where it lies.
    """
    cut = [] if g.plan.config.sheets is None else [(s, _digest(inputs, s.cells)) for s in sheets(g)]
    rasters = raster_table(g.plan.config)
    for name in g.plan.config.exported:
        raster = final(name, g.plan.config)
        whole = WriteCog(
            product=name,
            out=out,
            tags=_tags(g.plan, name, whole_inputs),
            nodata=nodata_of(g.plan, name),
            name=name,
            raster=raster,
            spec=g.spec,
            compress=g.plan.config.compress,
            fill=rasters[raster].fill,
            area=g.plan.area_key,
        )
        if g.plan.config.sheets is None:
            yield _cog_task(whole, g.checksums(raster))
            continue
        for sheet, read in cut:
            spec = sheet.spec
            near = g.spec.blocks_within(spec.block_bounds(spec.block_at(0, 0, spec.height)), BLOCK_PIXELS)
            seen = g.checksums(raster, (block.name for block in near))
            work = replace(
                whole,
                name=name_of(g, name, sheet),
                out=joined(out, name),
                spec=spec,
                whole=g.spec,
                tags=_tags(g.plan, name, read),
            )
            yield _cog_task(work, seen)


def _digest(inputs: Inputs, cells: Iterable[Cell]) -> str:
    """Digest of the inputs that have points in some buckets."""
    return digest_of(sorted(set[str]().union(*(inputs.get(cell, ()) for cell in cells))))


def _cog_task(work: WriteCog, blocks: list[list[str]]) -> Task:
    pixels = work.spec.height * work.spec.width
    return Task("export", f"{work.name}.tif", digest_of(work, blocks), write_cog, work, pixels)


def mosaic_tasks(g: Gridding, whole_inputs: str, out: str) -> Iterator[Task]:
    """One VRT for each product that is cut into sheets."""
    if g.plan.config.sheets is None:
        return
    cut = sheets(g)
    for name in g.plan.config.exported:
        files = [(name_of(g, name, sheet), sheet.spec) for sheet in cut]
        refuse_alike(g.plan.config.sheet_name, (file for file, _ in files))
        work = WriteMosaic(
            product=name,
            out=out,
            tags=_tags(g.plan, name, whole_inputs),
            nodata=nodata_of(g.plan, name),
            sheets=tuple((raster_file(name, file), spec) for file, spec in files),
        )
        yield Task("mosaic", mosaic_file(name), digest_of(work), write_mosaic, work)


def legend_tasks(g: Gridding, out: str) -> Iterator[Task]:
    """One for each raster of classes that is one file; over sheets the VRT has the names of the classes."""
    for name in g.plan.config.exported if g.plan.config.sheets is None else ():
        if PRODUCTS[name].values:
            work = WriteLegend(product=name, name=f"{raster_file(name)}{LEGEND}", out=out)
            yield Task("export", work.name, digest_of(__version__, work), write_legend, work)


def index_tasks(tasks: Iterable[Task], written: Commits, out: str) -> Iterator[Task]:
    """The one that draws where the sheets lie, from the records of those that were written."""
    works = [
        t.arguments for t in tasks if isinstance(t.arguments, WriteCog) and t.arguments.whole is not None
    ]
    found = []
    for work in works:
        record = written.get(f"{work.name}.tif", ("", None))[1]
        if record is not None:
            path = raster_file(work.product, work.name)
            void = 100 * (1 - record["valid"] / record["pixels"])
            found.append(SheetFile(work.product, path, work.spec, void, record["min"], record["max"]))
    if found:
        index = WriteSheetIndex(name=SHEETS, sheets=tuple(found), out=out)
        yield Task("mosaic", SHEETS, digest_of(__version__, index), write_sheet_index, index)


def _side(g: Gridding) -> float:
    """Side of a sheet in units of the CRS; 0 where there are none."""
    return float(g.plan.meta.frame.counts(g.plan.config.sheets or Fraction(0)) / COUNTS_PER_UNIT)


def sheets(g: Gridding) -> list[Sheet]:
    """Sheets that hold points, on a lattice anchored at CRS 0."""
    assert g.plan.config.sheets is not None  # the callers' choice
    lattice, spec = Lattice(g.plan.meta.frame.counts(g.plan.config.sheets)), g.spec
    side = int(lattice.size / spec.lattice.size)
    buckets: dict[Cell, list[Cell]] = defaultdict(list)
    for bucket, record in g.assembled.records.items():
        if record["bounds"]:
            for cell in lattice.cells(Bounds.from_json(record["bounds"])):
                buckets[cell].append(bucket)
    cells = sorted(buckets)
    if g.plan.area is not None:
        cells = [cell for cell in cells if g.plan.area.touches(lattice.bounds(cell))]
    return [
        Sheet(
            (
                float(cell.ix * lattice.size / COUNTS_PER_UNIT),
                float(cell.iy * lattice.size / COUNTS_PER_UNIT),
            ),
            RasterSpec(spec.lattice, cell.ix * side, (cell.iy + 1) * side, side, side),
            buckets[cell],
        )
        for cell in cells
    ]


def nodata_of(plan: Plan, name: str) -> float | None:
    """What the files of a product say where it has no value, if that is the user's to say: not of codes and greys."""
    return plan.config.nodata if PRODUCTS[name].nodata == NODATA else None


def _tags(plan: Plan, name: str, inputs: str) -> dict[str, str]:
    config = plan.config
    datum = vertical_name(plan.meta.frame.crs_wkt) if name in MODELS else None
    settings: dict[str, Any] = {
        "interpolation": config.interpolation,
        "surface": config.surface or "all",
        "erode_m": float(config.erosion),
        "max_edge_m": float(config.max_edge),
        "voids": config.voids,
        "spike_m": float(config.spike),
    }
    return {
        "TILER_VERSION": __version__,
        "TILER_METHOD": config.method,
        "TILER_PARAMETERS": json.dumps(plan.parameters, sort_keys=True),
        "TILER_GRID": json.dumps(settings, sort_keys=True),
        "TILER_INPUTS": inputs,
        **({} if datum is None else {"VERTICAL_DATUM": datum}),
    }


def _window(plan: Plan, info: SourceInfo) -> tuple[tuple[int, int], ...]:
    """Records, of a source of which the run fetched only a part, that may be inside the area; none for others."""
    chunks = (chunks_of(plan, info, 0) or chunks_of(plan, info)) if is_url(info.path) else None
    found = [] if chunks is None else window_pieces(info, chunks, PIECE_POINTS)
    return tuple(records for ranges in found for records in ranges)


def kept_pieces(spooled: Commits) -> dict[str, list[KeptPiece]]:
    """Name of a source -> its pieces in order."""
    found: dict[str, list[KeptPiece]] = defaultdict(list)
    for key in sorted(spooled):
        source, _, start = key.partition("-")
        record = spooled[key][1]
        found[source].append(KeptPiece(key, int(start), record["read"], record["identity"]))
    return found


def classified_tasks(
    plan: Plan,
    sources: Iterable[Source],
    spooled: Commits,
    labels: Mapping[Cell, str],
    out: str,
) -> Iterator[Task]:
    """One task for each classified cloud."""
    records, pieces, sources = by_source(spooled), kept_pieces(spooled), list(sources)
    # Workers of a cluster are other machines': what a task takes there is one core.
    threads = 1 if plan.config.scheduler else max(plan.workers // max(len(sources), 1), 1)
    for source in sources:
        touched = {Cell(ix, iy) for r in records[source.name] for ix, iy, _ in r["buckets"]}
        cells = sorted(touched & labels.keys())  # a bucket whose task failed is not there
        extent = claimed_bounds(source.info)
        whole = plan.area is None or (extent is not None and plan.area.covers(extent))
        work = WriteClassified(
            path=location(source.info.path),
            source=source.number,
            out=joined(out, CLASSIFIED, str(plan.names[source.info.path])),
            labels=LABELS,
            cells=tuple(cells),
            salvage=plan.config.salvage,
            area=None if whole else plan.area_key,
            stamp=source.info.stamp,
            ranges=_window(plan, source.info),
            copc=plan.config.classified == "copc",
            pieces=tuple(pieces[source.name]),
            threads=threads,
        )
        digest = digest_of(__version__, source.identity, work, [labels[c] for c in cells], "statistics")
        points = sum(count for _, count in work.ranges) or source.info.points
        yield Task("export", f"c{source.number:06d}", digest, write_classified, work, points)
