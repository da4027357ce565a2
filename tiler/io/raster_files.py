"""Files of rasters: GeoTIFFs (metadata, and plain tiled files written block by block), and PNG pictures from arrays."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from affine import Affine
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.io import MemoryFile
from rasterio.windows import Window

from ptd.arrays import Float32, UInt8
from tiler.core.raster import BLOCK_PIXELS, NODATA
from tiler.errors import write_error
from tiler.io.atomic_files import atomic_path, cause_of

CACHE_BYTES = 64
"""Limit of GDAL's block cache, with which it keeps no block. Files are read and written once, so a larger cache takes
memory and no less time. GDAL's default is a share of the machine's memory."""


@dataclass(frozen=True)
class RasterMetadata:
    """Metadata of a raster file.

    Attributes
    ----------
    crs : str or None
        WKT or authority code, or None if unknown.
    unit : str
        Vertical unit of the band, as `tiler.core.units.unit_label` returns it.
    description : str
        Description of the band.
    tags : mapping of str to str
        Tags of the data set.
    dtype : str
    nodata : float or None
    colours : mapping of int to (red, green, blue)
        Colour table of a uint8 band, empty if there is none.
    meanings : mapping of str to str
        Tags of the band with the meaning of its values, empty if the values are measures.
    categories : tuple of str
        Names of the values 0, 1, 2 ... if these are classes. A GeoTIFF cannot contain them.
    """

    crs: str | None
    unit: str
    description: str
    tags: Mapping[str, str]
    dtype: str = "float32"
    nodata: float | None = NODATA
    colours: Mapping[int, tuple[int, int, int]] = field(default_factory=dict)
    meanings: Mapping[str, str] = field(default_factory=dict)
    categories: tuple[str, ...] = ()


class PlainWriter:
    """Writer of the blocks of an open raster."""

    def __init__(self, raster: Any) -> None:
        self._raster = raster

    def write(self, values: Float32, row: int, col: int) -> None:
        """Write a block, shape (height, width), whose north-west pixel is (row, col)."""
        values = values.astype(self._raster.dtypes[0], copy=False)
        self._raster.write(values, 1, window=Window(col, row, values.shape[1], values.shape[0]))

    def tag_band(self, tags: Mapping[str, str]) -> None:
        """Set metadata of the band."""
        self._raster.update_tags(1, **tags)


def tiled_profile(height: int, width: int, transform: Sequence[float]) -> dict[str, Any]:
    """Return rasterio's options, except bands and CRS, for a tiled GeoTIFF (BigTIFF if it may exceed 4 GB)."""
    blocks = {
        "tiled": True,
        "blockxsize": BLOCK_PIXELS,
        "blockysize": BLOCK_PIXELS,
        "BIGTIFF": "IF_SAFER",
    }
    return {
        "driver": "GTiff",
        "height": height,
        "width": width,
        "transform": Affine(*transform),
        **blocks,
    }


@contextmanager
def plain_geotiff(
    path: Path,
    height: int,
    width: int,
    transform: tuple[float, float, float, float, float, float],
    look: RasterMetadata,
) -> Iterator[PlainWriter]:
    """Open a new tiled GeoTIFF for blocks in any order: not compressed, BigTIFF if it may exceed 4 GB.

    Blocks that are never written stay nodata and need no disk space.

    Parameters
    ----------
    path : Path
        Path of the file, which replaces a file with this name.
    height, width : int
        Size in pixels.
    transform : tuple of float
        a, b, c, d, e, f of rasterio's ``Affine``, for pixels that are areas.
    look : RasterMetadata
        Metadata of the file.

    Raises
    ------
    ProcessingError
        The file cannot be written.
    """
    crs = None if look.crs is None else CRS.from_user_input(look.crs)
    profile = {
        "count": 1,
        "dtype": look.dtype,
        "nodata": look.nodata,
        "crs": crs,
        "SPARSE_OK": True,
    }
    if look.colours:
        profile["photometric"] = "palette"
    with (
        any_place(),
        rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES),
        raster_errors(path),
        rasterio.open(
            path, "w", **tiled_profile(height, width, transform), **profile
        ) as raster,
    ):
        raster.update_tags(AREA_OR_POINT="Area", **look.tags)
        if look.colours:  # GDAL accepts colours only before the first pixel.
            raster.write_colormap(1, dict(look.colours))
        if look.unit:
            raster.units = (look.unit,)
        raster.set_band_description(1, look.description)
        yield PlainWriter(raster)


@contextmanager
def any_place() -> Iterator[None]:
    """Suppress rasterio's warning that a raster at (0, 0) with pixels of one unit has no position, which is wrong."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        yield


@contextmanager
def raster_errors(path: Path) -> Iterator[None]:
    """Convert errors of rasterio and of the disk to a ProcessingError that names the file."""
    try:
        yield
    except RasterioError as error:
        raise write_error(str(path), cause_of(path, error), path.parent) from error
    except OSError as error:
        raise write_error(str(path), error, path.parent) from error


DEFLATE_LEVEL = 4
"""Compression level of PNGs, with a third of the time of the usual level 6 and files a few
percent larger."""


def palette_png_bytes(values: UInt8, colours: Mapping[int, tuple[int, int, int]]) -> bytes:
    """Return the bytes of a PNG with a palette, for a picture of few colours.

    Parameters
    ----------
    values : uint8, shape (height, width)
        Value of each pixel. 0 is transparent.
    colours : mapping of int to (red, green, blue)
        Colour of each value.
    """
    table = {value: (*colour, 255) for value, colour in colours.items()}
    return _encoded(values[None], {**table, 0: (0, 0, 0, 0)})


def _encoded(bands: UInt8, colours: Mapping[int, tuple[int, int, int, int]] | None) -> bytes:
    count, height, width = bands.shape
    profile = {
        "driver": "PNG",
        "height": height,
        "width": width,
        "count": count,
        "dtype": "uint8",
    }
    profile["ZLEVEL"] = DEFLATE_LEVEL
    with any_place(), MemoryFile() as memory:
        with memory.open(**profile) as picture:
            picture.write(bands)
            if colours is not None:
                picture.write_colormap(1, colours)
        return bytes(memory.read())


def write_png(path: Path, rgba: UInt8) -> None:
    """Write a picture as a PNG, which appears when it is complete. Raise ProcessingError if this fails.

    The picture is uint8 (height, width, 4): red, green, blue, opacity.
    """
    with raster_errors(path), atomic_path(path) as partial:
        partial.write_bytes(_encoded(np.moveaxis(rgba, -1, 0), None))
