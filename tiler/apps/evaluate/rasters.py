"""Opens rasters that tiler may not have written; whatever is wrong with one is an error of one line that names it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rasterio
from fsspec.core import url_to_fs
from pyproj.exceptions import ProjError
from rasterio.errors import CRSError, RasterioError

from tiler.errors import InputError
from tiler.io.locations import is_url, state_at
from tiler.redaction import printable


@contextmanager
def open_raster(path: Path | str, what: str = "cannot be read") -> Iterator[Any]:
    """The data set of rasterio, for as long as it is used.

    Raises
    ------
    InputError
        The raster cannot be opened or read, or what it says of itself is no text or no CRS.
    """
    with raster_named(path, what), opened(path) as raster:
        # Damaged text is told of here: where two rasters are open, it is not known later whose it was.
        _ = raster.units, raster.tags(), raster.tags(1), raster.crs
        yield raster


def opened(path: Path | str) -> Any:
    """The data set of rasterio; of one at a URL what is asked for is read, as its overviews need little."""
    if not is_url(path):
        return rasterio.open(path)
    if state_at(str(path)) is None:
        raise InputError(f"{path}: nothing there; name a raster")
    return rasterio.open(str(path), opener=url_to_fs(str(path))[0])


@contextmanager
def raster_named(path: Path | str, what: str = "cannot be read") -> Iterator[None]:
    """Turn whatever reading a raster raises into an InputError that names it."""
    try:
        yield
    except (RasterioError, CRSError, ProjError, UnicodeDecodeError) as error:
        reason = printable(" ".join(str(error).split()))
        raise InputError(f"{path}: {what} ({reason}); name a readable raster") from error
