"""Raster of the differences of swaths, with a style for QGIS that shows which are within the limit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tiler.apps.acceptance.separation import Separation
from tiler.core.crs import split_wkt
from tiler.core.raster import NODATA
from tiler.core.units import METRE, unit_label
from tiler.errors import write_error
from tiler.io.atomic_files import atomic_path, write_atomic
from tiler.io.raster_files import RasterMetadata, plain_geotiff, raster_errors

_MARK = "<!-- written by tiler check -->"
"""Comment of the styles that may be replaced."""
_COPIES = 3
"""Number of arrays of the size of the raster in memory."""
_COLOURS = ("#2ca02c", "#ffd92f", "#d62728")
"""Colours of differences within the limit, within twice the limit, and above (USGS Lidar Base Specification, swath
separation images)."""


def write_differences(
    path: Path, found: Separation, wkt: str | None, memory: int
) -> str | None:
    """Write the largest absolute difference of two swaths in each cell, or return why there is no raster.

    The GeoTIFF is float32, in metres.

    Parameters
    ----------
    path : Path
        GeoTIFF, which is replaced.
    found : Separation
    wkt : str or None
        CRS of the points. The raster has its horizontal part, because differences refer to no vertical datum.
    memory : int
        Memory that the raster may need, in bytes.

    Raises
    ------
    ProcessingError
        The file cannot be written.
    """
    if not found.difference_m.size:
        return "no shared cell of swaths can be compared"
    x0, y1 = found.x.min() - found.side / 2, found.y.max() + found.side / 2
    columns = np.rint((found.x - x0) / found.side - 0.5).astype(np.int64)
    rows = np.rint((y1 - found.y) / found.side - 0.5).astype(np.int64)
    height, width = int(rows.max()) + 1, int(columns.max()) + 1
    if height * width * 4 * _COPIES > memory:
        return f"{width:,} x {height:,} cells are too many for the memory of a process; give more with --memory"
    largest = np.full((height, width), NODATA, np.float32)
    largest[rows, columns] = np.abs(found.difference_m)
    transform = (found.side, 0.0, float(x0), 0.0, -found.side, float(y1))
    horizontal = split_wkt(wkt)[0]
    crs = None if horizontal is None else horizontal.to_wkt()
    look = RasterMetadata(crs, unit_label(METRE), "largest difference of two swaths", {})
    with (
        raster_errors(path),
        atomic_path(path) as partial,
        plain_geotiff(partial, height, width, transform, look) as raster,
    ):
        raster.write(largest, 0, 0)
    return None


def write_style(path: Path, limit_m: float) -> bool:
    """Write the style of the raster with the colours of `_COLOURS`, or return False if a user's style is there.

    Parameters
    ----------
    path : Path
        Style of QGIS (``.qml``).
    limit_m : float
        Limit of the colours in metres.

    Raises
    ------
    ProcessingError
        The file cannot be written.
    """
    try:
        if path.exists() and _MARK.encode() not in path.read_bytes():
            return False
        write_atomic(path, _style(limit_m).encode())
    except OSError as error:
        raise write_error(str(path), error, path.parent) from error
    return True


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
        f'{_MARK}<qgis version="3.22.0" styleCategories="Symbology"><pipe>'
        '<rasterrenderer type="singlebandpseudocolor" band="1" opacity="1" alphaBand="-1" '
        f'classificationMin="0" classificationMax="{ends[1]}"><rastershader>'
        '<colorrampshader colorRampType="DISCRETE" classificationMode="1" clip="0" '
        f'minimumValue="0" maximumValue="{ends[1]}">{items}</colorrampshader>'
        "</rastershader></rasterrenderer></pipe></qgis>"
    )
