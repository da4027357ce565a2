"""Raster of the differences of swaths, with a style for QGIS that shows which are within the limit, and as an image."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import rasterio

from ptd.arrays import AnyArray, Float64, Int64
from tiler.apps.acceptance.separation import Separation
from tiler.core.crs import split_wkt
from tiler.core.raster import NODATA
from tiler.core.units import METRE, unit_label
from tiler.errors import write_error
from tiler.io.atomic_files import atomic_path, write_atomic
from tiler.io.raster_files import RasterMetadata, any_place, plain_geotiff, raster_errors

_MARK = "<!-- written by tiler check -->"
"""Comment of the styles that may be replaced."""
_COPIES = 3
"""Number of arrays of the size of the raster in memory."""
_COLOURS = ("#2ca02c", "#ffd92f", "#d62728")
"""Colours of differences within the limit, within twice the limit, and above (USGS Lidar Base Specification, swath
separation images)."""
_GREYS, _NOTHING = 62, 255
"""Number of values of each colour of the image, from dark to bright, and the value without points."""
_IMAGE = "differences of swaths over their intensity"
"""Description of the images that may be replaced."""


class _Grid(NamedTuple):
    """Pixels around the cells in which swaths were compared. They are the cells."""

    west: float
    north: float
    side: float
    height: int
    width: int

    @classmethod
    def around(cls, found: Separation) -> _Grid:
        side = found.side
        west, north = found.x.min() - side / 2, found.y.max() + side / 2
        height, width = north - found.y.min(), found.x.max() - west
        return cls(
            float(west),
            float(north),
            side,
            round(height / side + 0.5),
            round(width / side + 0.5),
        )

    def pixels(self, x: Float64, y: Float64) -> tuple[Int64, Int64]:
        """Return the rows and columns of centres of cells."""
        rows = np.rint((self.north - y) / self.side - 0.5).astype(np.int64)
        return rows, np.rint((x - self.west) / self.side - 0.5).astype(np.int64)


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
    grid = _Grid.around(found)
    if grid.height * grid.width * 4 * _COPIES > memory:
        size = f"{grid.width:,} x {grid.height:,} cells"
        return f"{size} are too many for the memory of a process; give more with --memory"
    largest = np.full((grid.height, grid.width), NODATA, np.float32)
    largest[grid.pixels(found.x, found.y)] = np.abs(found.difference_m)
    look = RasterMetadata(
        _horizontal(wkt), unit_label(METRE), "largest difference of two swaths", {}
    )
    _write(path, largest, grid, look)
    return None


def write_image(path: Path, found: Separation, wkt: str | None, limit_m: float) -> bool:
    """Write the differences as colours over the intensity, or return False if another file is there.

    It is the swath separation image of the USGS Lidar Base Specification: the colours of `write_style` with the mean
    intensity of the single returns of a cell, half of each. Cells that were not compared are grey, those without
    points are nodata. The GeoTIFF is uint8 with a colour table.

    Parameters
    ----------
    path : Path
    found : Separation
        With compared cells.
    wkt : str or None
        CRS of the points.
    limit_m : float
        Limit of the colours in metres.

    Raises
    ------
    ProcessingError
        The file cannot be written.
    """
    if path.exists() and not _is_image(path):
        return False
    grid, backdrop = _Grid.around(found), found.backdrop
    rows, columns = grid.pixels(backdrop.x, backdrop.y)
    inside = (rows >= 0) & (rows < grid.height) & (columns >= 0) & (columns < grid.width)
    low, high = np.percentile(backdrop.intensity[inside], (2, 98))
    grey = np.clip((backdrop.intensity[inside] - low) / max(high - low, 1.0), 0, 1)
    values = np.full((grid.height, grid.width), _NOTHING, np.uint8)
    values[rows[inside], columns[inside]] = np.rint(grey * (_GREYS - 1))
    group = 1 + np.digitize(np.abs(found.difference_m), (limit_m, 2 * limit_m), right=True)
    values[grid.pixels(found.x, found.y)] += (group * _GREYS).astype(np.uint8)
    look = RasterMetadata(
        _horizontal(wkt), "", _IMAGE, {}, dtype="uint8", nodata=_NOTHING, colours=_palette()
    )
    _write(path, values, grid, look)
    return True


def _palette() -> dict[int, tuple[int, int, int]]:
    """Return the colours of the image: greys, and half of them with each colour of `_COLOURS`."""
    colours = {}
    for group, colour in enumerate(("", *_COLOURS)):
        for n in range(_GREYS):
            grey = n * 255 // (_GREYS - 1)
            red, green, blue = bytes.fromhex(colour[1:]) if colour else (grey,) * 3
            mixed = (grey + red) // 2, (grey + green) // 2, (grey + blue) // 2
            colours[group * _GREYS + n] = mixed
    return colours


def _is_image(path: Path) -> bool:
    try:
        with any_place(), rasterio.open(path) as raster:
            return bool(raster.descriptions == (_IMAGE,))
    except rasterio.RasterioIOError:
        return False


def _horizontal(wkt: str | None) -> str | None:
    horizontal = split_wkt(wkt)[0]
    return None if horizontal is None else str(horizontal.to_wkt())


def _write(path: Path, values: AnyArray, grid: _Grid, look: RasterMetadata) -> None:
    transform = (grid.side, 0.0, grid.west, 0.0, -grid.side, grid.north)
    with (
        raster_errors(path),
        atomic_path(path) as partial,
        plain_geotiff(partial, grid.height, grid.width, transform, look) as raster,
    ):
        raster.write(values, 0, 0)


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
