"""Tasks that write the files of a run: rasters (as one COG, or as sheets with a VRT) and classified clouds."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace

from tiler.config import LOW_AS_NOISE
from tiler.core.crs import vertical_name
from tiler.core.drawn_sheets import DrawnSheet, StoredAreas
from tiler.core.file_names import product_names, validate_distinct_names
from tiler.core.lattice import Cell
from tiler.core.points import LABELS
from tiler.core.products import MODELS, NODATA, PRODUCTS
from tiler.core.raster import BLOCK_PIXELS
from tiler.core.records import SpoolRecord, digest_of
from tiler.core.selection import ONLY_GROUND
from tiler.core.water import Waters
from tiler.export.classified import write_classified
from tiler.export.cloud_frame import crs_to_write
from tiler.export.output_files import (
    CloudCopy,
    NewClasses,
    OutFile,
    ProductInfo,
    RasterFileRecord,
    RasterPart,
    SheetFile,
)
from tiler.export.overview import THINNING, write_overview
from tiler.export.polygons import write_sheet_index
from tiler.export.rasters import write_cog, write_legend, write_mosaic
from tiler.export.tasks.sheets import key_of, name_of
from tiler.inputs import SourceInfo, header_bounds, window_pieces
from tiler.io.locations import is_url, joined, location
from tiler.io.result_folder import (
    CLASSIFIED,
    LEGEND,
    OVERVIEW,
    SHEETS,
    mosaic_file,
    raster_file,
    sheet_file,
)
from tiler.plan import PIECE_POINTS, Plan, chunks_of
from tiler.runs.found import Gridded, Source, by_source, final_raster
from tiler.schedule import Task, calling
from tiler.store import Commits, KeptPiece
from tiler.version import __version__

Inputs = Mapping[Cell, Collection[str]]
"""Digests of the sources that have points in a bucket, by bucket."""


def inputs_of(sources: Iterable[Source], spooled: Commits) -> Inputs:
    """Return the inputs of each bucket, from the commits of the pieces."""
    inputs: dict[Cell, set[str]] = defaultdict(set)
    records = by_source(spooled)
    for source in sources:
        for record in records.get(source.name, ()):
            for ix, iy, _ in record.buckets:
                inputs[Cell(ix, iy)].add(source.content)
    return inputs


def cog_tasks(context: Gridded, inputs: Inputs, whole_inputs: str, out: str) -> Iterator[Task]:
    """Yield one task per raster file.

    The tags of a sheet depend on the inputs that have points in the sheet, and the digest of
    its task also on its blocks. So another input changes only the sheets where it has points.
    """
    sheet_inputs = [(sheet, _digest(inputs, sheet.cells)) for sheet in context.sheets]
    names = product_names(context.plan.config.product_name)
    for name in context.plan.config.exported:
        raster = final_raster(name, context.plan.config)
        whole = RasterPart(
            raster=raster,
            spec=context.spec,
            fill=context.fills[raster],
            area=context.plan.inputs.area_key,
        )
        if context.plan.config.sheets is None:
            to, info = (
                OutFile(out, f"{names[name]}.tif"),
                _info(context.plan, name, whole_inputs),
            )
            yield _cog_task(context, name, to, info, whole, context.checksums(raster))
            continue
        for sheet, inputs_digest in sheet_inputs:
            spec = sheet.spec
            near = context.spec.blocks_within(spec.bounds, BLOCK_PIXELS)
            seen = context.checksums(raster, (block.name for block in near))
            to = OutFile(joined(out, name), f"{name_of(context, name, sheet)}.tif")
            info = _info(context.plan, name, inputs_digest)
            part = replace(whole, spec=spec, whole=context.spec)
            yield _cog_task(context, key_of(name, sheet), to, info, part, seen, sheet.drawn)


def _digest(inputs: Inputs, cells: Iterable[Cell]) -> str:
    """Return the digest of the inputs that have points in some buckets."""
    return digest_of(sorted(set[str]().union(*(inputs.get(cell, ()) for cell in cells))))


def _cog_task(
    context: Gridded,
    key: str,
    to: OutFile,
    info: ProductInfo,
    part: RasterPart,
    blocks: list[list[str]],
    drawn: DrawnSheet | None = None,
) -> Task:
    compress, pixels = context.plan.config.compress, part.spec.height * part.spec.width
    call = calling(write_cog, to=to, info=info, part=part, compress=compress)
    if drawn is not None:
        clip = StoredAreas((drawn.area.key, *drawn.earlier), context.drawn)
        call = calling(write_cog, to=to, info=info, part=part, compress=compress, clip=clip)
    return Task.of("export", f"{key}.tif", call, blocks, pixels=pixels)


def mosaic_tasks(context: Gridded, whole_inputs: str, out: str) -> Iterator[Task]:
    """Yield one task per product that is divided into sheets, which writes its VRT."""
    for name in context.plan.config.exported if context.sheets else ():
        files = [(name_of(context, name, sheet), sheet.spec) for sheet in context.sheets]
        validate_distinct_names(context.plan.config.sheet_template, (file for file, _ in files))
        info, outside = _info(context.plan, name, whole_inputs), None
        if context.plan.inputs.sheets:
            nodata = PRODUCTS[name].nodata if info.nodata is None else info.nodata
            fill = context.fills[final_raster(name, context.plan.config)]
            outside = fill if nodata is None else nodata
        call = calling(
            write_mosaic,
            to=OutFile(out, mosaic_file(name)),
            info=info,
            sheets=tuple((sheet_file(name, file), spec) for file, spec in files),
            **({} if outside is None else {"outside": outside}),
        )
        yield Task.of("mosaic", mosaic_file(name), call)


def legend_tasks(context: Gridded, out: str) -> Iterator[Task]:
    """Yield one task per raster of classes that is a single file.

    If a product is divided into sheets, its VRT contains the names of the classes.
    """
    for name in context.plan.config.exported if context.plan.config.sheets is None else ():
        if PRODUCTS[name].values:
            file = raster_file(name, context.plan.config.product_name)
            call = calling(write_legend, to=OutFile(out, f"{file}{LEGEND}"), product=name)
            yield Task.of("export", f"{name}.tif{LEGEND}", call)


def index_tasks(cogs: Iterable[Task], written: Commits, out: str) -> Iterator[Task]:
    """Yield the task that writes the index of the sheets, if sheets were written.

    ``cogs`` are the tasks of `cog_tasks`.
    """
    sheet_files = []
    for task in cogs:
        values = task.arguments
        part, product = values["part"], values["info"].product
        if part.whole is not None and task.key in written:
            record = RasterFileRecord.of(written[task.key][1])
            path = f"{product}/{values['to'].name}"
            void = 100 * (1 - record.valid / max(record.own, 1))
            sheet_files.append(
                SheetFile(
                    product, path, part.spec, void, record.min, record.max, values.get("clip")
                )
            )
    if sheet_files:
        index = calling(write_sheet_index, to=OutFile(out, SHEETS), sheets=tuple(sheet_files))
        yield Task.of("mosaic", SHEETS, index)


def nodata_of(plan: Plan, name: str) -> float | None:
    """Return the nodata value of the settings, or None for products of codes or grey values.

    The user cannot change the nodata value of these products.
    """
    return plan.config.nodata if PRODUCTS[name].nodata == NODATA else None


def _info(plan: Plan, name: str, inputs: str) -> ProductInfo:
    """Return the metadata of a file of a product, made from ``inputs`` (a digest)."""
    config = plan.config
    datum = vertical_name(plan.frame.crs_wkt) if name in MODELS else None
    settings: dict[str, str | float] = {
        "interpolation": config.interpolation,
        "surface": config.surface or "all",
        "erode_m": float(config.erosion),
        "max_edge_m": float(config.max_edge),
        "voids": config.voids,
        "spike_m": float(config.spike),
    }
    tags = {
        "TILER_VERSION": __version__,
        "TILER_METHOD": config.method,
        "TILER_PARAMETERS": json.dumps(plan.method.parameters, sort_keys=True),
        "TILER_GRID": json.dumps(settings, sort_keys=True),
        "TILER_INPUTS": inputs,
        **({} if datum is None else {"VERTICAL_DATUM": datum}),
    }
    return ProductInfo(name, tags, nodata_of(plan, name))


def _window(plan: Plan, info: SourceInfo) -> tuple[tuple[int, int], ...]:
    """Return the ranges of records that may be inside the area if the run fetched only a part of a source, else ()."""
    chunks = (chunks_of(plan, info, 0) or chunks_of(plan, info)) if is_url(info.path) else None
    pieces = [] if chunks is None else window_pieces(info, chunks, PIECE_POINTS)
    return tuple(records for ranges in pieces for records in ranges)


def kept_pieces(spooled: Commits) -> dict[str, list[KeptPiece]]:
    """Return the pieces of each source in order, by the name of the source."""
    pieces: dict[str, list[KeptPiece]] = defaultdict(list)
    for key in sorted(spooled):
        source, _, start = key.partition("-")
        _, stored = spooled[key]
        record = SpoolRecord.of(stored)
        piece = KeptPiece(key, int(start), record.read, record.identity, record.sums)
        pieces[source].append(piece)
    return pieces


def classified_tasks(
    context: Gridded,
    sources: Iterable[Source],
    spooled: Commits,
    labels: Mapping[Cell, str],
    out: str,
) -> Iterator[Task]:
    """Yield one task per classified cloud. The digests of the labels include the changes of the edits."""
    plan, waters = context.plan, context.waters
    wet = _wet(plan, waters, labels)
    records, pieces, sources = by_source(spooled), kept_pieces(spooled), list(sources)
    # Workers of a cluster have one core per task, so only local tasks compress with several
    # threads.
    threads = (
        1 if plan.config.scheduler else max(plan.resources.workers // max(len(sources), 1), 1)
    )
    for source in sources:
        touched = {Cell(ix, iy) for r in records[source.name] for ix, iy, _ in r.buckets}
        # A bucket is missing from `labels` if its assembly failed.
        cells = sorted(touched & labels.keys())
        extent = header_bounds(source.info)
        whole = plan.inputs.area is None or (
            extent is not None and plan.inputs.area.covers(extent)
        )
        cloud = CloudCopy(
            path=location(source.info.path),
            source=source.number,
            out=joined(out, CLASSIFIED, plan.inputs.cloud_names[source.info.path].as_posix()),
            labels=LABELS,
            cells=tuple(cells),
            salvage=plan.config.salvage,
            waters=waters.key if wet else None,
            low_is_noise=bool(wet) and plan.config.water_low == LOW_AS_NOISE,
            reclass=plan.config.reclass,
            area=None if whole else plan.inputs.area_key,
            edits=context.edits,
            stamp=source.info.stamp,
            ranges=_window(plan, source.info),
            copc=plan.config.classified == "copc",
            pieces=tuple(pieces[source.name]),
            threads=threads,
            wkt=crs_to_write(source.info, plan.frame.crs_wkt, plan.config.crs),
        )
        points = sum(count for _, count in cloud.ranges) or source.info.points
        yield Task.of(
            "export",
            f"c{source.number:06d}",
            calling(write_classified, cloud=cloud),
            source.identity,
            [[labels[c], wet.get(c)] for c in cells],
            points=points,
            bounds=plan.buckets.hull(cells) if cells else None,
        )


def overview_task(
    context: Gridded, sources: Iterable[Source], labels: Mapping[Cell, str], out: str
) -> Task:
    """Return the task that writes the overview of the classified clouds."""
    plan, waters, cells = context.plan, context.waters, sorted(labels)
    sources = list(sources)
    wet = _wet(plan, waters, cells)
    overview = NewClasses(
        labels=LABELS,
        cells=tuple(cells),
        area=plan.inputs.area_key,
        edits=context.edits,
        waters=waters.key if wet else None,
        low_is_noise=bool(wet) and plan.config.water_low == LOW_AS_NOISE,
        reclass=plan.config.reclass,
    )
    return Task.of(
        "export",
        OVERVIEW,
        calling(write_overview, overview=overview, to=OutFile(out, OVERVIEW)),
        sorted(source.identity for source in sources),
        [[labels[cell], wet.get(cell)] for cell in cells],
        points=sum(source.info.points for source in sources) // THINNING,
    )


def _wet(plan: Plan, waters: Waters, cells: Iterable[Cell]) -> dict[Cell, list[str]]:
    """Return the digests of the bodies of water that overlap each bucket, or {} if points do not become water."""
    lattice, known, digests = plan.buckets, frozenset(cells), defaultdict(list)
    if plan.config.reclass != ONLY_GROUND:
        return {}
    for body in waters.bodies:
        key = digest_of(body.digest)
        for cell in lattice.among(body.area.bounds, known):
            if body.area.touches(lattice.bounds(cell)):
                digests[cell].append(key)
    return dict(digests)
