"""The tasks of the rasters that are made after the terrain's, and of the files; digests as in `tiler.tasks`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from tiler import __version__
from tiler.core.lattice import Cell
from tiler.core.products import PRODUCTS
from tiler.core.raster import Block, RasterSpec
from tiler.export import write_cog
from tiler.grid import density_block, derive_block, distance_block, full_halo, reach_pixels, surface_block
from tiler.plan import GRID_BLOCK, Plan
from tiler.schedule import Task, Work, digest_of
from tiler.tasks import Assembled, ground_arguments, raster_spec

Commits = Mapping[str, tuple[str, dict[str, Any]]]
Made = Mapping[str, Commits]
"""Name of a raster -> the commits of its blocks."""

DERIVED = {"ndsm": ("dsm", "dtm"), "hillshade": ("dtm",), "slope": ("dtm",)}
"""Products that follow from other rasters, and from which."""

FROM_POINTS: dict[str, Work] = {
    "dsm": surface_block,
    "density": density_block,
    "distance": distance_block,
}


def wanted(products: tuple[str, ...]) -> list[str]:
    """The rasters to make for some products, each after those that it follows from."""
    names = {"dtm", *products}
    for product in products:
        names.update(DERIVED.get(product, ()))
    return [name for name in PRODUCTS if name in names]


def fill_of(name: str, plan: Plan) -> float:
    """What the store holds where no block was written."""
    if name == "distance":
        return float(plan.config.max_edge)
    nodata = PRODUCTS[name].nodata
    return 0.0 if nodata is None else nodata


def product_tasks(
    name: str, plan: Plan, assembled: Assembled, labels: Mapping[Cell, str], made: Made
) -> Iterator[Task]:
    """One for each block of a product that can hold anything."""
    if name in DERIVED:
        yield from _derived_tasks(name, plan, assembled, made)
    else:
        yield from _point_tasks(name, plan, assembled, labels)


def _point_tasks(name: str, plan: Plan, assembled: Assembled, labels: Mapping[Cell, str]) -> Iterator[Task]:
    spec = raster_spec(plan, assembled)
    special, reach = _point_arguments(name, plan, assembled)
    common = {"name": name, "spec": spec.to_json(), **ground_arguments(plan), **special}
    for block in spec.blocks(GRID_BLOCK):
        window = spec.block_bounds(block).pad(reach)
        near = [cell for cell in plan.meta.bucket.cells(window) if cell in labels]
        if not near:
            continue
        arguments = {**common, "block": [block.row, block.col, block.height, block.width]}
        digest = digest_of(__version__, arguments, [[cell.ix, cell.iy, labels[cell]] for cell in near])
        points = sum(assembled.records[cell]["n"] for cell in near)
        yield Task(f"grid-{name}", block.name, digest, FROM_POINTS[name], arguments, points)


def _point_arguments(name: str, plan: Plan, assembled: Assembled) -> tuple[dict[str, Any], int]:
    """Arguments of a product alone, and how far its pixels see, in counts."""
    frame = plan.meta.frame
    limit = frame.counts(plan.config.max_edge)
    if name == "distance":
        return {"cap": str(limit)}, math.ceil(limit) + 1
    if name == "dsm":
        reach = reach_pixels(plan.resolution)
        arguments = {
            "data": assembled.bounds().to_json(), "max_edge": str(limit), "reach": reach,
            "spike": str(plan.config.spike / frame.metres_z), "halo": math.ceil(frame.counts(plan.grid_halo)),
        }  # fmt: skip
        return arguments, full_halo(limit) + math.ceil((reach + 1) * frame.counts(plan.resolution))
    return {}, 0


def _derived_tasks(name: str, plan: Plan, assembled: Assembled, made: Made) -> Iterator[Task]:
    """Their pixels see one pixel of the blocks around."""
    spec = raster_spec(plan, assembled)
    sources = {source: source for source in DERIVED[name]}
    common = {"name": name, "product": name, "spec": spec.to_json(), "fill": fill_of(name, plan), **sources}
    for block in spec.blocks(GRID_BLOCK):
        if any(block.name not in made[source] for source in sources.values()):
            continue
        arguments = {**common, "block": [block.row, block.col, block.height, block.width]}
        seen = [_around(made[source], block) for source in sources.values()]
        digest = digest_of(__version__, arguments, seen)
        yield Task(f"grid-{name}", block.name, digest, derive_block, arguments, block.height * block.width)


def _around(commits: Commits, block: Block) -> list[list[str]]:
    """Checksums of a block and of its eight neighbours."""
    near = [
        Block(block.row + down, block.col + right, 0, 0).name
        for down in (-GRID_BLOCK, 0, GRID_BLOCK)
        for right in (-GRID_BLOCK, 0, GRID_BLOCK)
    ]
    return [[key, commits[key][1]["checksum"]] for key in near if key in commits]


def cog_task(plan: Plan, spec: RasterSpec, commits: Commits, inputs: str, out: Path, name: str) -> Task:
    """The raster as a file."""
    blocks = [[key, record["checksum"]] for key, (_, record) in sorted(commits.items())]
    arguments = {
        "name": name, "product": name, "spec": spec.to_json(), "out": str(out), "compress": plan.config.compress,
        "tags": {
            "TILER_VERSION": __version__, "TILER_METHOD": plan.config.method,
            "TILER_PARAMETERS": _text(plan.parameters), "TILER_INPUTS": inputs,
        },
    }  # fmt: skip
    return Task(
        "export", f"{name}.tif", digest_of(arguments, blocks), write_cog, arguments, spec.height * spec.width
    )


def _text(parameters: Mapping[str, Any]) -> str:
    import json

    return json.dumps(parameters, sort_keys=True)
