"""Validation of settings and inputs, with a remedy in each error."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path

from tiler.config import RunConfig
from tiler.core.file_names import (
    LONGEST,
    check_template,
    fault_of_name,
    fault_on_windows,
    fields_of,
    link_error,
    name_prefix,
    product_names,
    sheet_name,
    validate_distinct_names,
)
from tiler.core.lattice import COUNTS_PER_UNIT, Lattice
from tiler.core.products import PRODUCTS, VECTOR_PRODUCTS
from tiler.core.raster import RasterSpec
from tiler.core.units import Sides, in_unit_of_crs, length_option, sides_text, whole_length
from tiler.core.words import listed
from tiler.errors import ConfigError
from tiler.io.atomic_files import MAX_NAME_LENGTH, name_bytes
from tiler.io.locations import joined
from tiler.io.overwrite_check import (
    Target,
    check_folder,
    check_links,
    check_targets,
    same_file,
)
from tiler.io.result_folder import (
    BRIDGES,
    CHANGED,
    CLASSIFIED,
    COPC_SUFFIX,
    EVENTS,
    LEGEND,
    OUTDATED,
    OUTLINE,
    OVERVIEW,
    REPORT,
    RESULTS,
    REVIEW,
    RUN,
    SHEET_ITEMS,
    SHEETS,
    STAC,
    STORE,
    VIRTUAL,
    WATER,
    earlier_outputs,
    foreign_files,
    local_folder,
    mosaic_file,
    raster_file,
)
from tiler.io.vector.opening import validate_closed
from tiler.plan.estimates import (
    existing_folder,
    free_bytes,
    needed_bytes,
    pixels_of,
    projected_memory,
    sparse_raster_remedy,
)
from tiler.plan.memory import memory_bytes
from tiler.plan.model import Plan
from tiler.plan.sizes import resolution_of

Replan = Callable[..., Plan]
"""Function that makes a plan with other values of settings, given by name."""

MAX_DENOMINATOR = 511
"""Maximum denominator of a pixel's side, which is a fraction of counts, with which gridding is
exact in int64."""
MAX_PIXEL = 1 << 26
"""Side of a pixel in counts below which gridding is exact in int64."""

MAX_LISTED = 5
"""Maximum number of files listed in an error. The others are counted."""


FILE_SUFFIXES = (
    ".tif",
    ".tiff",
    ".vrt",
    ".las",
    ".laz",
    ".gpkg",
    ".asc",
    ".img",
    ".png",
    ".html",
    ".json",
)
"""Endings of file names. A user who gives an OUT with such an ending probably means the terrain
model."""


def other_inputs(config: RunConfig) -> list[str]:
    """Return the files that a run reads in addition to its clouds."""
    names = (
        config.aoi,
        config.edits,
        config.water_file,
        config.sheet_file,
        config.priority_file,
    )
    return [*(name for name in names if name is not None), *config.breaklines]


def water_is_given(config: RunConfig, products: str) -> bool:
    """Return whether ``--water`` names the file of water in OUT. Then a run neither writes nor moves it."""
    given = config.water_file
    return given is not None and same_file(given, joined(products, WATER))


def validate_output_paths(config: RunConfig, products: str, paths: Sequence[Path]) -> None:
    """Raise ConfigError if OUT, store and inputs conflict, or if OUT has a file's name."""
    stem, suffix = os.path.splitext(products)
    if suffix.lower() in FILE_SUFFIXES and not os.path.isdir(products):
        raise ConfigError(
            f"-o {products}: has the name of a file, but is the folder of all results; use -o "
            f"{stem}, which will contain dtm.tif"
        )
    if config.sheets is None:
        _validate_product_names(config.product_name)
    for name in (CLASSIFIED, OUTDATED):
        check_folder("-o", joined(products, name), paths)
    for name in config.drawn if config.sheets is not None else ():
        check_folder(
            "-o", joined(products, name), [Path(path) for path in other_inputs(config)]
        )
    store = config.store or joined(products, STORE)
    check_folder("--store", store, [products, *paths, *other_inputs(config)])
    for name in (CLASSIFIED, OUTDATED, *config.cut):
        check_folder("-o", joined(products, name), [store])


def _validate_product_names(given: str | None) -> None:
    """Raise ConfigError if a raster would have the name of another result."""
    taken = {name.partition(".")[0] for name in RESULTS} | {*PRODUCTS, *VECTOR_PRODUCTS}
    for product, name in product_names(given).items():
        if name.lower() in taken - {product}:
            raise ConfigError(
                f"--product-name {given}: {name!r} is the name of another result; give {product} another name"
            )


def validate_targets(plan: Plan, products: str, paths: Sequence[Path]) -> None:
    """Raise ConfigError if a run would overwrite inputs, files that no run in OUT wrote, or an open GeoPackage."""
    out = local_folder(products)
    file_names = _targets(plan)
    earlier = earlier_outputs(out, products).keys() - set(file_names)
    if water_is_given(plan.config, products):
        file_names.remove(WATER)
        earlier.discard(WATER)
    locations = [joined(products, name) for name in file_names]
    for folder in (str(out), products):
        locations += [joined(folder, name) for name in (RUN, EVENTS, REPORT, CHANGED)]
    reads: list[str | Path] = [*paths, *other_inputs(plan.config)]
    if plan.config.edits is not None and same_file(plan.config.edits, joined(products, REVIEW)):
        reads.remove(plan.config.edits)  # Its decisions stay in the new file.
    check_targets([Target("", location) for location in locations], reads)
    _validate_links(plan, products, file_names)
    validate_closed(products, {*file_names, *earlier})
    if plan.config.force:
        return
    sheet_prefixes = {}
    if plan.config.sheets is not None:
        names = {SHEET_ITEMS: SHEET_ITEMS, **product_names(plan.config.product_name)}
        sheet_prefixes = {
            folder: name_prefix(plan.config.sheet_template, names.get(folder, folder))
            for folder in (*plan.config.cut, SHEET_ITEMS)
        }
    foreign_paths = foreign_files(out, products, file_names, sheet_prefixes)
    if foreign_paths:
        raise ConfigError(
            f"-o {products}: {listed(foreign_paths, MAX_LISTED)}: already exists and was not written by a "
            "run in this folder; use another -o, or --force to replace them"
        )


def _validate_links(plan: Plan, products: str, file_names: Sequence[str]) -> None:
    """Raise ConfigError if a run would write through a link in OUT."""
    events = local_folder(products) / EVENTS
    if events.is_symlink():
        raise link_error(events, "-o")
    # The names of sheets and of archived files are not known yet.
    folders = [OUTDATED]
    if plan.config.sheets is not None:
        folders += [*plan.config.cut, SHEET_ITEMS]
    check_links("-o", products, [*file_names, CHANGED, *(f"{folder}/x" for folder in folders)])


def _targets(plan: Plan) -> list[str]:
    """Return the names in OUT of the files of a run, except run.json, log, report and sheets."""
    exported = plan.config.exported
    if plan.config.sheets is not None:
        names = [mosaic_file(name) for name in exported]
        names.append(SHEETS)
    else:
        files = {name: raster_file(name, plan.config.product_name) for name in exported}
        names = list(files.values())
        names += [f"{file}{LEGEND}" for name, file in files.items() if PRODUCTS[name].values]
    names += [f"{name}.gpkg" for name in plan.config.drawn]
    if plan.config.bridges == "remove":
        names.append(BRIDGES)
    if plan.config.outline == "survey":
        names.append(OUTLINE)
    if plan.config.water != "none":
        names.append(WATER)
    names += [REVIEW, STAC]
    if plan.writes_clouds:
        names += [VIRTUAL, *([OVERVIEW] if plan.writes_overview else ())]
        names += [
            f"{CLASSIFIED}/{name.as_posix()}" for name in plan.inputs.cloud_names.values()
        ]
    return names


def _error(plan: Plan, text: str) -> ConfigError:
    """Return an error whose text has lengths in the unit of the CRS."""
    return ConfigError(in_unit_of_crs(text, plan.frame.units))


def _option(plan: Plan, metres: Fraction) -> str:
    return length_option(metres, plan.frame.units.horizontal)


def validate_resolution(plan: Plan) -> None:
    """Raise ConfigError if gridding would not be exact with the pixels of a plan."""
    pixel = plan.frame.counts(plan.grid.resolution)
    if pixel.denominator > MAX_DENOMINATOR:
        raise _error(
            plan,
            f"--resolution {float(plan.grid.resolution):g} m: {float(pixel) / COUNTS_PER_UNIT:.9g} CRS units "
            "is not a simple fraction; give it in the unit of the CRS",
        )
    if pixel >= MAX_PIXEL:
        limit_m = float(MAX_PIXEL * plan.frame.metres_xy)
        raise _error(
            plan,
            f"--resolution {float(plan.grid.resolution):g} m: pixels must be below {limit_m:.0f} m; use smaller pixels",
        )


def validate_pixel_count(plan: Plan, out: Path | None) -> None:
    """Raise ConfigError if a raster is too large only because of its fine pixels."""
    usual = _usual_pixel(plan)
    if usual is None:
        return
    if not sparse_raster_remedy(plan, out) or sparse_raster_remedy(usual, out):
        return
    pixels, spacing = pixels_of(plan).largest, 1 / math.sqrt(plan.inputs.density)
    raise _error(
        plan,
        f"--resolution {float(plan.grid.resolution):g} m: a single raster would have {pixels:.2g} pixels, but the "
        f"points are {spacing:.2g} m apart; use --resolution {_option(plan, usual.grid.resolution)}, or --sheets",
    )


def _usual_pixel(plan: Plan) -> Plan | None:
    """Return the plan with the default pixel, or None if the requested pixel is not finer."""
    config, unit = plan.config.updated(resolution=None), plan.frame.units.horizontal
    usual = resolution_of(config, plan.inputs.density, plan.method.kind, unit, [])
    if usual <= plan.grid.resolution:
        return None
    return replace(plan, grid=replace(plan.grid, resolution=usual))


def validate(plan: Plan, out: Path | None, replan: Replan) -> None:
    """Raise ConfigError if a run would fail because of memory, disk, resolution, sheets or names.

    Parameters
    ----------
    plan : Plan
    out : Path or None
        Folder whose disk is checked.
    replan : callable
        Function that makes the plan for other values of settings, given by name, to find values that suffice.
    """
    _validate_memory(plan, replan)
    validate_resolution(plan)
    _validate_sheets(plan)
    _validate_cloud_names(plan)
    if out is not None:
        _validate_disk(plan, out)


def _validate_sheets(plan: Plan) -> None:
    """Raise ConfigError if a sheet would not have whole pixels, or files of sheets would have no valid names."""
    config, pixel = plan.config, plan.grid.resolution
    if config.sheets is None:
        return
    if isinstance(config.sheets, Sides):
        whole = Sides(*(max(round(side / pixel), 1) * pixel for side in config.sheets))
        for side in config.sheets:
            if (side / pixel).denominator != 1:
                raise _error(
                    plan,
                    f"--sheets {float(side):g} m is not a whole number of pixels of {float(pixel):g} m; use --sheets "
                    f"{sides_text(whole, partial(_option, plan))} or another --resolution",
                )
        if "sheet" in fields_of(config.sheet_template):
            raise ConfigError(
                f"--sheet-name {config.sheet_template}: {{sheet}} is the name of a sheet in a file; use {{x}} and {{y}}"
            )
    names = product_names(config.product_name)
    lattice = Lattice(plan.frame.counts(pixel))
    edges = [
        RasterSpec.enclosing(lattice, sheet.area.bounds).edges for sheet in plan.inputs.sheets
    ]
    for product in config.cut:
        name = names.get(product, product)
        check_template(config.sheet_template, name)
        files = [
            sheet_name(config.sheet_template, name, of, sheet.name)
            for sheet, of in zip(plan.inputs.sheets, edges, strict=True)
        ]
        validate_distinct_names(config.sheet_template, files)
        for file in files:
            fault = fault_of_name(file)
            if len(file.encode()) > LONGEST:
                fault = f"has more than {LONGEST} bytes"
            if fault:
                raise ConfigError(
                    f"--sheet-name {config.sheet_template}: {file!r} {fault}; use another template"
                )


def _validate_cloud_names(plan: Plan) -> None:
    """Raise ConfigError if a classified cloud would have a name that its file system does not allow."""
    if not plan.writes_clouds:
        return
    for source, name in plan.inputs.cloud_names.items():
        fault = fault_on_windows(name.name) if os.name == "nt" else ""
        if fault:
            raise ConfigError(
                f"{source}: the name of its classified cloud {name.name} {fault}; rename the input, or use "
                "--classified none"
            )
        size = name_bytes(name)
        if size > MAX_NAME_LENGTH:
            shorter = ""
            if size - len(COPC_SUFFIX) + len(".laz") <= MAX_NAME_LENGTH:
                shorter = ", use --classified laz"
            raise ConfigError(
                f"{source}: its classified cloud {name.name[:20]}...{name.suffix} would have a name of {size} bytes, "
                f"but at most {MAX_NAME_LENGTH} are possible; rename the input{shorter}, or use --classified none"
            )


def _validate_memory(plan: Plan, replan: Replan) -> None:
    memory = projected_memory(plan)
    stage = max(memory, key=lambda name: memory[name])
    need = memory[stage]
    if need > plan.resources.memory:
        raise ConfigError(
            f"{stage} needs {need / 2**20:,.0f} MiB per worker, but {plan.resources.memory / 2**20:,.0f} MiB are "
            f"allowed; use --memory {enough_memory(plan, replan) >> 20}MiB{_instead(plan, stage, replan)}"
        )
    workers, machine = plan.config.workers or 1, memory_bytes()
    if plan.config.scheduler is None and workers * need > max(machine, need):
        raise ConfigError(
            f"--workers {workers}: each needs {need / 2**20:,.0f} MiB ({stage}), but this machine has "
            f"{machine / 2**20:,.0f} MiB; use --workers {max(machine // need, 1)}"
        )


def enough_memory(plan: Plan, replan: Replan) -> int:
    """Return the bytes of memory that suffice for a worker, a whole number of MiB.

    With more memory, tiles become larger and then need more memory. So the search is repeated
    until it suffices.
    """
    required_bytes = max(projected_memory(plan).values())
    while True:
        allowed = math.ceil(required_bytes / 2**20) << 20
        needed = max(projected_memory(replan(memory=allowed)).values())
        if needed <= allowed:
            return allowed
        required_bytes = max(needed, int(1.01 * allowed))


def _instead(plan: Plan, stage: str, replan: Replan) -> str:
    """Recommend a setting other than more memory with which a stage fits, or return ""."""
    if stage == "grid" and plan.grid.halo_m > plan.grid.resolution:
        return " or a smaller --max-edge"
    if stage != "filter":
        return ""

    def suffices(**values: Fraction) -> bool:
        other = replan(memory=plan.resources.memory, **values)
        return max(projected_memory(other).values()) <= plan.resources.memory

    unit = plan.frame.units.horizontal
    side = Fraction(plan.method.tile)
    bucket = Fraction(plan.grid.bucket_m)
    smallest = whole_length(bucket, unit, math.ceil)
    while side >= bucket:
        tile = whole_length(side, unit, math.ceil)
        if suffices(tile_size=tile):
            return f" or --tile-size {_option(plan, tile)}"
        side = side / 2 // bucket * bucket
    halo = whole_length(plan.method.halo_m / 2, unit, math.floor)
    while halo >= 1:
        if suffices(tile_size=smallest, halo=halo):
            return f" or --halo {_option(plan, halo)} --tile-size {_option(plan, smallest)}"
        halo = whole_length(halo / 2, unit, math.floor)
    return " or another --method"


def _validate_disk(plan: Plan, out: Path) -> None:
    try:
        str(out).encode()
    except UnicodeEncodeError as error:  # GDAL, which writes the rasters, needs names in UTF-8.
        raise ConfigError(
            f"-o {out}: its name is not UTF-8; give another folder, or use a UTF-8 locale (LC_ALL=C.UTF-8)"
        ) from error
    try:
        existing = existing_folder(out)
    except OSError as error:
        raise ConfigError(f"-o {out}: {error.strerror}; give another folder") from error
    if not existing.is_dir():
        raise ConfigError(f"-o {out}: {existing} is a file; give a folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise ConfigError(
            f"-o {out}: {existing} cannot be written; give a folder that can be written"
        )
    need, free = needed_bytes(plan), free_bytes(out)
    if need > free:
        remedy = "free some space, or use --store on another disk or fewer --products"
        usual = _usual_pixel(plan)
        if usual is not None and needed_bytes(usual) <= free:
            coarser, present = (
                _option(plan, usual.grid.resolution),
                _option(plan, plan.grid.resolution),
            )
            remedy = f"use --resolution {coarser} instead of {present}, or free some space"
        raise ConfigError(
            f"{out}: needs about {need / 1e6:,.0f} MB, but {free / 1e6:,.0f} MB are free; {remedy}"
        )
