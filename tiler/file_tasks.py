"""The tasks that write the files of the products: one COG each, or sheets and a VRT over them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

from tiler import __version__
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Bounds, Lattice
from tiler.core.products import NODATA, PRODUCTS
from tiler.core.raster import RasterSpec
from tiler.export import write_cog, write_mosaic
from tiler.places import joined
from tiler.plan import Plan
from tiler.product_tasks import Gridding, checksums, final
from tiler.schedule import Task, digest_of
from tiler.tasks import area_key


def cog_tasks(g: Gridding, inputs: str, out: str) -> Iterator[Task]:
    """One for each file."""
    for name in g.plan.config.exported:
        raster = final(name, g.plan.config)
        common: dict[str, Any] = {
            "raster": raster, "product": name, "compress": g.plan.config.compress, "tags": _tags(g.plan, inputs),
            "area": area_key(g.plan), "fill": g.fill_of(raster), **_nodata(g.plan, name),
        }  # fmt: skip
        blocks = checksums(g.made[raster])
        if g.plan.config.sheets is None:
            files = [({**common, "name": name, "spec": g.spec.to_json(), "out": out}, g.spec)]
        else:
            whole = {"whole": g.spec.to_json(), "out": joined(out, name)}
            files = [
                ({**common, **whole, "name": f"{name}_{place}", "spec": spec.to_json()}, spec)
                for place, spec in sheets(g)
            ]
        for arguments, spec in files:
            key = f"{arguments['name']}.tif"
            yield Task(
                "export", key, digest_of(arguments, blocks), write_cog, arguments, spec.height * spec.width
            )


def mosaic_tasks(g: Gridding, inputs: str, out: str) -> Iterator[Task]:
    """One VRT for each product that is cut into sheets."""
    if g.plan.config.sheets is None:
        return
    for name in g.plan.config.exported:
        arguments = {
            "product": name, "out": out, "tags": _tags(g.plan, inputs), **_nodata(g.plan, name),
            "sheets": [[f"{name}/{name}_{place}.tif", spec.to_json()] for place, spec in sheets(g)],
        }  # fmt: skip
        yield Task("mosaic", f"{name}.vrt", digest_of(arguments), write_mosaic, arguments)


def sheets(g: Gridding) -> list[tuple[str, RasterSpec]]:
    """Sheets that hold points, on a lattice anchored at CRS 0: coordinates of the south-west corner, and pixels."""
    assert g.plan.config.sheets is not None  # the callers' choice
    lattice, spec = Lattice(g.plan.meta.frame.counts(g.plan.config.sheets)), g.spec
    side = int(lattice.size / spec.lattice.size)
    filled = [Bounds.from_json(r["bounds"]) for r in g.assembled.records.values() if r["bounds"]]
    cells = sorted({cell for bounds in filled for cell in lattice.cells(bounds)})
    if g.plan.area is not None:
        cells = [cell for cell in cells if g.plan.area.touches(lattice.bounds(cell))]
    return [
        (
            "_".join(_place(i * lattice.size) for i in (cell.ix, cell.iy)),
            RasterSpec(spec.lattice, cell.ix * side, (cell.iy + 1) * side, side, side),
        )
        for cell in cells
    ]


def _place(counts: Fraction) -> str:
    """A coordinate in units of the CRS for a file's name: ``2600000``, ``0.5``."""
    return f"{float(counts / COUNTS_PER_UNIT):.3f}".rstrip("0").rstrip(".")


def _nodata(plan: Plan, name: str) -> dict[str, float]:
    """What the files of a product say where it has no value, if that is the user's to say: not of codes and greys."""
    return {"nodata": plan.config.nodata} if PRODUCTS[name].nodata == NODATA else {}


def _tags(plan: Plan, inputs: str) -> dict[str, str]:
    config = plan.config
    settings: dict[str, Any] = {
        "interpolation": config.interpolation, "surface": config.surface, "erode_m": float(config.erode),
        "max_edge_m": float(config.max_edge), "voids": config.voids, "spike_m": float(config.spike),
    }  # fmt: skip
    return {
        "TILER_VERSION": __version__, "TILER_METHOD": config.method,
        "TILER_PARAMETERS": json.dumps(plan.parameters, sort_keys=True),
        "TILER_GRID": json.dumps(settings, sort_keys=True), "TILER_INPUTS": inputs,
    }  # fmt: skip
