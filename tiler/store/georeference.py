"""Attributes of a raster that give its position, CRS and nodata value to other programs.

They follow the Zarr conventions ``spatial`` and ``proj``, and xarray's encoding of a nodata value. The store itself
does not read them.
"""

from __future__ import annotations

import base64
import struct
from typing import Any

from pyproj import CRS

from tiler.core.crs import raster_crs
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.products import NODATA, PRODUCTS
from tiler.core.raster import RasterSpec

DIMENSIONS = "spatial:dimensions"
"""Attribute with the names of the axes, which zarr records as ``dimension_names``, too."""


def _declared(name: str, uuid: str, description: str) -> list[dict[str, str]]:
    """Return the entries that declare a convention: one of its version 0.1, and one with the name of its drafts.

    GDAL recognizes a convention by its UUID, and rioxarray 0.23 by the name with a colon.
    """
    return [
        {
            "schema_url": f"https://raw.githubusercontent.com/zarr-conventions/{name}/refs/tags/v0.1/schema.json",
            "spec_url": f"https://github.com/zarr-conventions/{name}/blob/v0.1/README.md",
            "uuid": uuid,
            "name": name,
            "description": description,
        },
        {"uuid": uuid, "name": f"{name}:"},
    ]


_SPATIAL = _declared(
    "spatial", "689b58e2-cf7b-45e0-9fff-9cfc0883d6b4", "Spatial coordinate information"
)
_PROJ = _declared(
    "proj",
    "f17cb550-5864-4468-aeb7-f3180cfb622f",
    "Coordinate reference system information for geospatial data",
)


def raster_attributes(
    name: str, spec: RasterSpec, crs_wkt: str | None, fill: float
) -> dict[str, Any]:
    """Return the JSON-able attributes of a raster. There are none of ``proj`` if there is no CRS.

    The fill is a nodata value if the file of the product has it as such, and if a raster that is not a product holds
    `NODATA`. Any other fill is a value of pixels, such as no points.
    """
    attributes: dict[str, Any] = {
        "zarr_conventions": _SPATIAL,
        DIMENSIONS: _dimensions(spec),
        "spatial:transform": list(spec.transform(COUNTS_PER_UNIT)),
        "spatial:shape": [spec.height, spec.width],
        "spatial:bbox": list(spec.edges),
        "spatial:registration": "pixel",
    }
    crs = raster_crs(crs_wkt)
    if crs is not None:
        attributes["zarr_conventions"] = _SPATIAL + _PROJ
        attributes["proj:wkt2"] = CRS.from_wkt(crs).to_wkt()
    if fill == (PRODUCTS[name].nodata if name in PRODUCTS else NODATA):
        attributes["_FillValue"] = base64.standard_b64encode(struct.pack("<d", fill)).decode()
    return attributes


def _dimensions(spec: RasterSpec) -> list[str]:
    """Return the names of the rows and of the columns: first pixel, number of pixels, and side of a pixel in counts.

    xarray takes equal names for equal axes, and the rasters of a store have pixels of several sizes and extents.
    """
    side = f"{spec.lattice.p}_{spec.lattice.q}"
    return [f"y_{spec.north}_{spec.height}_{side}", f"x_{spec.west}_{spec.width}_{side}"]
