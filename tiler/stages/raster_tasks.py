"""The tasks of all rasters of a run but the terrain's own, and of their files; digests as in `tiler.stages.tasks`.

Besides the products there are rasters that only the store holds: ``occupancy`` and ``survey`` (coarse cells, see
`tiler.grid.survey`), and for a model of which voids are filled ``<name>-voids`` and ``<name>-filled``.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from tiler.config import RunConfig
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.products import PRODUCTS
from tiler.core.raster import Block, RasterSpec, north_west
from tiler.grid import (
    blocks_of,
    density_block,
    derive_block,
    distance_block,
    fill_block,
    find_voids,
    full_halo,
    mask_block,
    occupancy_block,
    reach_pixels,
    surface_block,
    survey_raster,
)
from tiler.plan import GRID_BLOCK, Plan
from tiler.schedule import Task, Work, digest_of
from tiler.stages.tasks import Assembled, area_key, grid_tasks, ground_arguments, raster_spec
from tiler.store import Commits
from tiler.version import __version__

MODELS = ("dtm", "dsm")
"""Products whose voids can be filled."""

DERIVED = {"ndsm": ("dsm", "dtm"), "hillshade": ("dtm",), "slope": ("dtm",)}
"""Products that follow from models, and from which."""

FROM_POINTS: dict[str, Work] = {
    "dsm": surface_block,
    "density": density_block,
    "distance": distance_block,
    "occupancy": occupancy_block,
}

WHOLE = "whole"
"""Key of the one task of a raster that is made at once."""

COARSE_SHARE = 16
"""Coarse cells along the longest edge of a facet."""
MAX_COARSE_CELLS = 8_000_000
"""Coarse cells of a run at most; larger runs have larger cells, so that the memory of one worker suffices."""


@dataclass
class Gridding:
    """What the stage grid works on, and what it has made: name of a raster -> commits of its blocks.

    Attributes
    ----------
    holes : sequence of Bounds
        Where tiles failed, so that heights there, if any, come from elsewhere.
    """

    plan: Plan
    assembled: Assembled
    labels: Mapping[Cell, str]
    holes: Sequence[Bounds] = ()
    made: dict[str, Commits] = field(default_factory=dict)

    @property
    def spec(self) -> RasterSpec:
        """Pixels of the products."""
        return raster_spec(self.plan, self.assembled)

    @property
    def coarse(self) -> RasterSpec:
        """Coarse cells of the run."""
        size, bounds = self.coarse_m, self.assembled.bounds
        return RasterSpec.covering(Lattice(self.plan.meta.frame.counts(size)), bounds)

    @property
    def coarse_m(self) -> Fraction:
        """Metres of a coarse cell."""
        size = max(self.plan.config.max_edge / COARSE_SHARE, self.plan.resolution)
        area = self.assembled.bounds.area() * self.plan.meta.frame.metres_xy**2
        while area / size**2 > MAX_COARSE_CELLS:
            size *= 2
        return size

    def spec_of(self, name: str) -> RasterSpec:
        """Pixels or cells of a raster."""
        return self.coarse if name in ("occupancy", "survey") or name.endswith("-voids") else self.spec

    def fill_of(self, name: str) -> float:
        """What the store holds where no block was written."""
        if name == "distance":
            return float(self.plan.config.max_edge)
        product = PRODUCTS.get(name.removesuffix("-filled"))
        return 0.0 if product is None or product.nodata is None else product.nodata


def final(name: str, config: RunConfig) -> str:
    """The raster of the store that holds a product as people get it."""
    return f"{name}-filled" if name in MODELS and config.voids != "leave" else name


def wanted(config: RunConfig) -> list[str]:
    """The rasters to make, each after those that it follows from."""
    products = {"dtm", *config.exported}
    for product in config.exported:
        products.update(DERIVED.get(product, ()))
    fill = config.voids != "leave"
    names = ["dtm", *(("occupancy", "survey") if fill or "mask" in products else ())]
    for model in MODELS:
        names += [model] if model in products and model != "dtm" else []
        names += [f"{model}-voids", f"{model}-filled"] if model in products and fill else []
    return names + [name for name in PRODUCTS if name in products and name not in MODELS]


def raster_tasks(name: str, g: Gridding) -> Iterator[Task]:
    """One for each block of a raster that can hold anything, or one for the whole."""
    if name == "dtm":
        return grid_tasks(g.plan, g.assembled, g.labels, name)
    if name in DERIVED:
        return _derived_tasks(name, g)
    if name == "survey":
        return _survey_task(g)
    if name == "mask":
        return _mask_tasks(g)
    if name.endswith("-voids"):
        return _voids_task(name, g)
    if name.endswith("-filled"):
        return _fill_tasks(name, g)
    return _point_tasks(name, g)


def _near(g: Gridding, spec: RasterSpec, reach: int = 0) -> dict[Block, list[Cell]]:
    """Blocks within ``reach`` counts of buckets, each with these."""
    return spec.blocks_near(g.plan.meta.bucket, g.labels, GRID_BLOCK, reach)


def _of_block(block: Block) -> list[int]:
    return [block.row, block.col, block.height, block.width]


def _point_tasks(name: str, g: Gridding) -> Iterator[Task]:
    spec = g.spec_of(name)
    special, reach = _point_arguments(name, g)
    common = {"name": name, "spec": spec.to_json(), **ground_arguments(g.plan), **special}
    reach += math.ceil(g.plan.meta.frame.counts(g.plan.config.erosion))
    below = [special["terrain"]] if "terrain" in special else []
    for block, near in _near(g, spec, reach).items():
        arguments = {**common, "block": _of_block(block)}
        under = [
            g.made[raster][block.name][1]["checksum"] for raster in below if block.name in g.made[raster]
        ]
        digest = digest_of(
            __version__, arguments, [[cell.ix, cell.iy, g.labels[cell]] for cell in near], under
        )
        points = sum(g.assembled.records[cell]["n"] for cell in near)
        yield Task(f"grid-{name}", block.name, digest, FROM_POINTS[name], arguments, points)


def _point_arguments(name: str, g: Gridding) -> tuple[dict[str, Any], int]:
    """Arguments of a product alone, and how far its pixels see, in counts."""
    plan, frame = g.plan, g.plan.meta.frame
    limit = frame.counts(plan.config.max_edge)
    if name == "distance":
        return {"cap": str(limit)}, math.ceil(limit) + 1
    if name == "dsm":
        reach = reach_pixels(plan.resolution)
        arguments = {
            "data": g.assembled.bounds.to_json(), "max_edge": str(limit), "reach": reach,
            "spike": str(plan.config.spike / frame.metres_z), "halo": math.ceil(frame.counts(plan.grid_halo)),
            "terrain": final("dtm", plan.config),
        }  # fmt: skip
        return arguments, full_halo(limit) + math.ceil((reach + 1) * frame.counts(plan.resolution))
    return {}, 0


def _survey_task(g: Gridding) -> Iterator[Task]:
    coarse = g.coarse
    arguments = {
        "name": "survey", "spec": coarse.to_json(), "occupancy": "occupancy",
        "bridge": float(g.plan.config.max_edge / g.coarse_m), "pixels": g.spec.to_json(),
    }  # fmt: skip
    digest = digest_of(__version__, arguments, checksums(g.made["occupancy"]))
    yield Task("grid-survey", WHOLE, digest, survey_raster, arguments, coarse.height * coarse.width)


def _voids_task(name: str, g: Gridding) -> Iterator[Task]:
    spec, model = g.spec, name.removesuffix("-voids")
    arguments = {
        "name": name, "heights": model, "spec": spec.to_json(), "survey": "survey", "coarse": g.coarse.to_json(),
    }  # fmt: skip
    digest = digest_of(__version__, arguments, checksums(g.made[model]), checksums(g.made["survey"]))
    yield Task(f"grid-{name}", WHOLE, digest, find_voids, arguments, spec.height * spec.width)


def _fill_tasks(name: str, g: Gridding) -> Iterator[Task]:
    """Each depends on all blocks in which the rim of one of its holes can lie."""
    model, spec, coarse = name.removesuffix("-filled"), g.spec, g.coarse
    found = g.made[f"{model}-voids"]
    boxes = found[WHOLE][1]["voids"] if WHOLE in found else []
    common = {
        "name": name, "heights": model, "spec": spec.to_json(), "survey": "survey", "coarse": coarse.to_json(),
        "numbers": f"{model}-voids",
    }  # fmt: skip
    voids_of: dict[str, list[int]] = defaultdict(list)
    rims: list[str] = []
    for number, runs in enumerate(found[WHOLE][1]["blocks"] if WHOLE in found else []):
        near = [block.name for block in blocks_of(runs, spec, GRID_BLOCK)]
        for key in near:
            voids_of[key].append(number)
        rims.append(
            digest_of([[key, g.made[model][key][1]["checksum"]] for key in near if key in g.made[model]])
        )
    survey, numbers = checksums(g.made["survey"]), checksums(found)
    for key in sorted(voids_of.keys() | g.made[model].keys()):
        mine = voids_of.get(key, [])
        own = g.made[model][key][1]["checksum"] if key in g.made[model] else None
        block = spec.block_named(key, GRID_BLOCK)
        arguments = {**common, "block": _of_block(block), "voids": [[n + 1, *boxes[n]] for n in mine]}
        seen = [own, survey, [numbers, *(rims[n] for n in mine)] if mine else []]
        digest = digest_of(__version__, arguments, seen)
        yield Task(f"grid-{name}", key, digest, fill_block, arguments, block.height * block.width)


def _mask_tasks(g: Gridding) -> Iterator[Task]:
    spec, heights = g.spec, final("dtm", g.plan.config)
    common = {
        "name": "mask", "spec": spec.to_json(), "dtm": "dtm", "filled": heights, "survey": "survey",
        "coarse": g.coarse.to_json(), "area": area_key(g.plan), **ground_arguments(g.plan),
    }  # fmt: skip
    survey = checksums(g.made["survey"])
    erode = math.ceil(g.plan.meta.frame.counts(g.plan.config.erosion))
    near = _near(g, spec, erode)
    holes: dict[Block, list[list[int]]] = defaultdict(list)
    for hole in g.holes:
        for block in spec.blocks_within(hole, GRID_BLOCK):
            holes[block].append(hole.to_json())
    inside = blocks_of(g.made["survey"][WHOLE][1]["blocks"], spec, GRID_BLOCK)
    made = (spec.block_named(key, GRID_BLOCK) for raster in ("dtm", heights) for key in g.made[raster])
    for block in sorted({*near, *holes, *inside, *made}, key=north_west):
        arguments = {**common, "block": _of_block(block), "holes": holes.get(block, [])}
        rasters = [
            g.made[name][block.name][1]["checksum"] for name in ("dtm", heights) if block.name in g.made[name]
        ]
        seen = [[cell.ix, cell.iy, g.labels[cell]] for cell in near.get(block, [])]
        digest = digest_of(__version__, arguments, survey, rasters, seen)
        yield Task("grid-mask", block.name, digest, mask_block, arguments, block.height * block.width)


def _derived_tasks(name: str, g: Gridding) -> Iterator[Task]:
    """Their pixels see one pixel of the blocks around."""
    spec = g.spec
    sources = {model: final(model, g.plan.config) for model in DERIVED[name]}
    common = {"name": name, "product": name, "spec": spec.to_json(), "fill": g.fill_of(name), **sources}
    keys = set.intersection(*(set(g.made[source]) for source in sources.values()))
    for block in sorted((spec.block_named(key, GRID_BLOCK) for key in keys), key=north_west):
        arguments = {**common, "block": _of_block(block)}
        seen = [_around(g.made[source], block) for source in sources.values()]
        digest = digest_of(__version__, arguments, seen)
        yield Task(f"grid-{name}", block.name, digest, derive_block, arguments, block.height * block.width)


def checksums(commits: Commits) -> list[list[str]]:
    """Name and checksum of each block of a raster."""
    return [[key, record["checksum"]] for key, (_, record) in sorted(commits.items())]


def _around(commits: Commits, block: Block) -> list[list[str]]:
    """Checksums of a block and of its eight neighbours."""
    near = [
        Block(block.row + down, block.col + right, 0, 0).name
        for down in (-GRID_BLOCK, 0, GRID_BLOCK)
        for right in (-GRID_BLOCK, 0, GRID_BLOCK)
    ]
    return [[key, commits[key][1]["checksum"]] for key in near if key in commits]
