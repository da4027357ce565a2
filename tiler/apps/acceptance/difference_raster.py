"""Raster of the differences of swaths, with a style for QGIS that shows which are within the limit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tiler.apps.acceptance.separation import Separation
from tiler.core.raster import NODATA
from tiler.core.units import METRE, unit_label
from tiler.errors import write_error
from tiler.io.atomic_files import atomic_path, write_atomic
from tiler.io.raster_files import RasterMetadata, plain_geotiff, raster_errors
from tiler.schedule import half_of_memory

_COPIES = 3
"""Number of arrays of the size of the raster in memory."""
_COLOURS = ("#2ca02c", "#ffd92f", "#d62728")
"""Colours of differences within the limit, within twice the limit, and above (USGS Lidar Base Specification, swath
separation images)."""


def write_differences(
    path: Path, found: Separation, crs: str | None, limit_m: float
) -> str | None:
    """Write the largest absolute difference of two swaths in each cell, or return why the raster is too large.

    The GeoTIFF is float32, in metres. A style next to it (``.qml``) has the colours of `_COLOURS`. A style that exists
    is kept, since it may be a user's work.

    Parameters
    ----------
    path : Path
        GeoTIFF, which is replaced.
    found : Separation
    crs : str or None
        WKT of the CRS, or None if it is unknown.
    limit_m : float
        Limit of the colours in metres.

    Raises
    ------
    ProcessingError
        A file cannot be written.
    """
    x0, y1 = found.x.min() - found.side / 2, found.y.max() + found.side / 2
    columns = np.rint((found.x - x0) / found.side - 0.5).astype(np.int64)
    rows = np.rint((y1 - found.y) / found.side - 0.5).astype(np.int64)
    height, width = int(rows.max()) + 1, int(columns.max()) + 1
    if height * width * 4 * _COPIES > half_of_memory():
        return f"{width:,} x {height:,} cells are too many for this machine's memory"
    largest = np.full((height, width), NODATA, np.float32)
    np.maximum.at(largest, (rows, columns), np.abs(found.difference_m).astype(np.float32))
    transform = (found.side, 0.0, float(x0), 0.0, -found.side, float(y1))
    look = RasterMetadata(crs, unit_label(METRE), "largest difference of two swaths", {})
    with (
        raster_errors(path),
        atomic_path(path) as partial,
        plain_geotiff(partial, height, width, transform, look) as raster,
    ):
        raster.write(largest, 0, 0)
    style = path.with_suffix(".qml")
    if not style.exists():
        try:
            write_atomic(style, _style(limit_m).encode())
        except OSError as error:
            raise write_error(str(style), error, style.parent) from error
    return None


def _style(limit_m: float) -> str:
    """Return the style of a raster layer of QGIS with three classes of differences."""
    ends = (f"{limit_m:g}", f"{2 * limit_m:g}", "inf")
    labels = (f"up to {ends[0]} m", f"up to {ends[1]} m", f"above {ends[1]} m")
    items = "".join(
        f'<item value="{end}" label="{label}" color="{colour}" alpha="255"/>'
        for end, label, colour in zip(ends, labels, _COLOURS, strict=True)
    )
    return (
        "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>"
        '<qgis version="3.22.0" styleCategories="Symbology"><pipe>'
        '<rasterrenderer type="singlebandpseudocolor" band="1" opacity="1" alphaBand="-1" '
        f'classificationMin="0" classificationMax="{ends[1]}"><rastershader>'
        '<colorrampshader colorRampType="DISCRETE" classificationMode="1" clip="0" '
        f'minimumValue="0" maximumValue="{ends[1]}">{items}</colorrampshader>'
        "</rastershader></rasterrenderer></pipe></qgis>"
    )
