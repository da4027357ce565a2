"""Refuses settings and inputs that cannot work, and names what would; warns of doubtful ones."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path

from tiler.config import RunConfig
from tiler.core.crs import crs_name, length_scale
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.products import PRODUCTS
from tiler.core.sheet_names import beginning
from tiler.errors import ConfigError
from tiler.io.locations import joined
from tiler.io.overwrite_check import Target, check_folder, check_targets
from tiler.io.result_folder import (
    ASIDE,
    BRIDGES,
    CLASSIFIED,
    EVENTS,
    LEGEND,
    OUTLINE,
    REPORT,
    RUN,
    SHEET_ITEMS,
    SHEETS,
    STAC,
    STORE,
    VIRTUAL,
    WATER,
    folder_here,
    foreign_files,
    mosaic_file,
    raster_file,
)
from tiler.plan.disk import free_bytes, needed_bytes
from tiler.plan.machine import memory_bytes
from tiler.plan.model import Plan, steps_of
from tiler.plan.projection import filter_peak, projected_memory

MAX_DENOMINATOR = 511
"""Largest denominator of a pixel's side in counts with which gridding is exact in int64."""
WIDEST_PIXEL = 1 << 26
"""Counts of a pixel's side from which on gridding is not exact in int64."""
WIDEST_RELIEF_M = 9000
WIDE_TILE = 2 + 2 * math.sqrt(2)
"""Side of a tile, in halos, with which twice the work is done."""

NAMED = 5
"""Files that a refusal names; the others are counted."""

MUCH_OVERLAP = 3.0
"""Padded area over core area, mean of the passes, above which a warning says so."""

STRETCHED = 1.05
"""Length in the plane over length on the ground, or the inverse, from which on a CRS is warned of: those made
for surveys stay within 1.03."""


def warnings_of(plan: Plan) -> list[str]:
    """What is probably wrong, or costs more than it need."""
    units, found = plan.meta.frame.units, []
    boxes = [(s.path, s.bounds) for s in plan.sources if s.points and s.bounds is not None]
    relief = (max(b[5] for _, b in boxes) - min(b[2] for _, b in boxes)) * float(units.vertical)
    if relief > WIDEST_RELIEF_M:
        found.append(
            f"heights span {relief:,.0f} m, more than any terrain: noise far from the ground, "
            "or z is in another unit; --units h,v"
        )
    for path, (x0, y0, z0, x1, y1, z1) in boxes:
        side = max(min(x1 - x0, y1 - y0), 1.0) * float(units.horizontal)
        rise = (z1 - z0) * float(units.vertical)
        if side > 50 and rise > 2 * side:
            found.append(
                f"{path}: rises {rise:,.0f} m over {side:,.0f} m: noise, or z is in another unit; --units h,v"
            )
    found += _stretched(plan)
    # What is not known to be a matched cloud is not warned of as one.
    steps, tile = steps_of(plan.passes, plan.kind or "lidar"), float(plan.tile)
    halos = [step.halo_m for step in steps if not plan.joins(step)]
    work = [
        math.prod(min(tile + 2 * halo, side) / min(tile, side) for side in plan.sides_m) for halo in halos
    ]
    if work and sum(work) > MUCH_OVERLAP * len(work):
        found.append(
            f"tiles of {tile:g} m with up to {max(halos):g} m of halo do {sum(work) / len(work):.1f} times "
            f"the work; use --tile-size {math.ceil(WIDE_TILE * max(halos))} or more --memory"
        )
    return found


def _stretched(plan: Plan) -> list[str]:
    """Tells of a CRS whose metres are none on the ground, as those of Web Mercator."""
    wkt, extent = plan.meta.frame.crs_wkt, plan.extent
    if wkt is None:
        return []
    x, y = (extent.x0 + extent.x1) / 2 / COUNTS_PER_UNIT, (extent.y0 + extent.y1) / 2 / COUNTS_PER_UNIT
    scale = length_scale(wkt, x, y)
    if scale is None or 1 / STRETCHED < scale < STRETCHED:
        return []
    return [
        f"the CRS {crs_name(wkt)} makes lengths {scale:.2f} times those on the ground here (x {x:,.0f}, y {y:,.0f}), "
        "and the filter takes them as they are; reproject the clouds to a CRS for surveys, such as UTM"
    ]


def read_besides(config: RunConfig) -> list[str]:
    """Files that a run reads besides its clouds."""
    names = (config.aoi, config.edits, config.water_file)
    return [*(name for name in names if name is not None), *config.breaklines]


def refuse_places(config: RunConfig, products: str, paths: Sequence[Path]) -> None:
    """Raise ConfigError where folders of a run lie where its inputs are, or the store where its files go."""
    for name in (CLASSIFIED, ASIDE):
        check_folder("-o", joined(products, name), paths)
    store = config.store or joined(products, STORE)
    check_folder("--store", store, [products, *paths, *read_besides(config)])
    for name in (CLASSIFIED, ASIDE, *config.exported):
        check_folder("-o", joined(products, name), [store])


def refuse_targets(plan: Plan, products: str, paths: Sequence[Path]) -> None:
    """Raise ConfigError where a run would write over what it reads, or over files that no run of its OUT made."""
    exported, sheets, out = plan.config.exported, plan.config.sheets is not None, folder_here(products)
    wanted = [mosaic_file(name) if sheets else raster_file(name) for name in exported]
    wanted += [f"{name}.gpkg" for name in plan.config.drawn]
    wanted += [BRIDGES] if plan.config.bridges == "remove" else []
    wanted += (
        [SHEETS] if sheets else [f"{raster_file(name)}{LEGEND}" for name in exported if PRODUCTS[name].values]
    )
    if plan.config.outline == "survey":
        wanted.append(OUTLINE)
    if plan.config.water != "none":
        wanted.append(WATER)
    wanted.append(STAC)
    if plan.writes_clouds:
        wanted.append(VIRTUAL)
        wanted += [f"{CLASSIFIED}/{name}" for name in plan.names.values()]
    places = [joined(products, name) for name in wanted]
    places += [joined(place, name) for place in (str(out), products) for name in (RUN, EVENTS, REPORT)]
    reads: list[str | Path] = [*paths, *read_besides(plan.config)]
    check_targets([Target("-o", place) for place in places], reads)
    if plan.config.force:
        return
    starts = (
        {name: beginning(plan.config.sheet_name, name) for name in (*exported, SHEET_ITEMS)} if sheets else {}
    )
    found = foreign_files(out, products, wanted, starts)
    if found:
        more = f" and {len(found) - NAMED:,} more" if len(found) > NAMED else ""
        raise ConfigError(
            f"-o {products}: {', '.join(found[:NAMED])}{more}: there already, and not known to be of a run of this "
            "folder; use another -o, or --force to replace them"
        )


def refuse_resolution(plan: Plan) -> None:
    """Raise ConfigError for pixels with which gridding would not be exact."""
    pixel = plan.meta.frame.counts(plan.resolution)
    if pixel.denominator > MAX_DENOMINATOR:
        raise ConfigError(
            f"--resolution {float(plan.resolution):g} m: {float(pixel) / COUNTS_PER_UNIT:.9g} CRS units "
            "is too odd a fraction; give it in the unit of the CRS"
        )
    if pixel >= WIDEST_PIXEL:
        most = float(WIDEST_PIXEL * plan.meta.frame.metres_xy)
        raise ConfigError(
            f"--resolution {float(plan.resolution):g} m: pixels are less than {most:,.0f} m wide; use a smaller one"
        )


def refuse(plan: Plan, out: Path | None) -> None:
    """Raise ConfigError for settings that would fail on the way: memory, disk, resolution."""
    _refuse_memory(plan)
    refuse_resolution(plan)
    sheets = plan.config.sheets
    if sheets is not None and (sheets / plan.resolution).denominator != 1:
        raise ConfigError(
            f"--sheets {float(sheets):g} m: no whole number of pixels of {float(plan.resolution):g} m; "
            f"use --sheets {float(max(round(sheets / plan.resolution), 1) * plan.resolution):g} or another --resolution"
        )
    if sheets is not None and len(plan.config.exported) > 1 and "{name" not in plan.config.sheet_name:
        raise ConfigError(
            f"--sheet-name {plan.config.sheet_name}: several products would have one name; write {{name}} into it"
        )
    if out is not None:
        _refuse_disk(plan, out)


def _refuse_memory(plan: Plan) -> None:
    memory = projected_memory(plan)
    worst = max(memory, key=lambda k: memory[k])
    if memory[worst] > plan.memory:
        raise ConfigError(
            f"{worst} needs {memory[worst] / 2**20:,.0f} MiB a worker, {plan.memory / 2**20:,.0f} MiB are allowed; "
            f"use --memory {memory[worst] // 2**20 + 1}MiB{_instead(plan, worst)}"
        )
    workers, machine = plan.config.workers or 1, memory_bytes()
    if plan.config.scheduler is None and workers * memory[worst] > max(machine, memory[worst]):
        raise ConfigError(
            f"--workers {workers}: each needs {memory[worst] / 2**20:,.0f} MiB ({worst}), this machine has "
            f"{machine / 2**20:,.0f} MiB; use --workers {max(machine // memory[worst], 1)}"
        )


def _instead(plan: Plan, stage: str) -> str:
    """The other setting that would make a stage fit, besides more memory; empty where there is none."""
    if stage == "grid" and plan.grid_halo > plan.resolution:
        return " or a smaller --max-edge"
    if stage != "filter":
        return ""

    def fits(side: float, halo: float) -> bool:
        halos = {step: halo if step.work.reach_m is None else step.halo_m for step in plan.likely}
        return all(filter_peak(plan, s, side, h, crowded=True) <= plan.memory for s, h in halos.items())

    count = int(float(plan.tile) // plan.bucket_m)
    sides = [plan.bucket_m * n for n in range(count - 1, 0, -1) if fits(plan.bucket_m * n, plan.halo_m)]
    if sides:
        return f" or --tile-size {sides[0]:g}"
    halos = [halo for halo in range(int(plan.halo_m), 0, -1) if fits(plan.bucket_m, halo)]
    if halos:
        return f" or --halo {halos[0]} --tile-size {plan.bucket_m:g}"
    return " or another --method"


def _refuse_disk(plan: Plan, out: Path) -> None:
    try:
        str(out).encode()
    except UnicodeEncodeError as error:  # as GDAL, which writes the rasters, takes no other names
        raise ConfigError(
            f"-o {out}: its name is not UTF-8; name another folder, or use a UTF-8 locale (LC_ALL=C.UTF-8)"
        ) from error
    try:
        existing = next(p for p in (out, *Path(os.path.realpath(out)).parents) if p.exists())
    except OSError as error:
        raise ConfigError(f"-o {out}: {error.strerror}; name another folder") from error
    if not existing.is_dir():
        raise ConfigError(f"-o {out}: {existing} is a file; name a folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise ConfigError(f"-o {out}: {existing} cannot be written; name a folder on a disk that can")
    need, free = needed_bytes(plan), free_bytes(out)
    if need > free:
        raise ConfigError(
            f"{out}: needs about {need / 1e6:,.0f} MB, {free / 1e6:,.0f} MB are free; "
            "free some, or use --store on another disk or fewer --products"
        )
