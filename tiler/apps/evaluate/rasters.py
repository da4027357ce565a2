"""Access to foreign rasters. Any fault in one becomes an error of one line with its path."""

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
from tiler.io.locations import is_url, reading_remedy, state_at
from tiler.redaction import printable


@contextmanager
def open_raster(path: Path | str, what: str = "cannot be read") -> Iterator[Any]:
    """Yield an open rasterio data set.

    Parameters
    ----------
    path : path or URL
    what : str
        Fault in the text of the error.

    Raises
    ------
    InputError
        The raster cannot be opened or read, or its texts or its CRS are invalid.
    """
    with raster_named(path, what), opened(path) as raster:
        # Damaged text is reported here. Later, with two rasters open, the damaged one would be
        # unknown.
        _ = raster.units, raster.tags(), raster.tags(1), raster.crs
        yield raster


def opened(path: Path | str) -> Any:
    """Open a rasterio data set. At a URL, only the requested parts of the file are read."""
    if not is_url(path):
        return rasterio.open(path)
    try:
        if state_at(str(path)) is None:
            raise InputError(f"{path}: nothing there; give a raster")
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error}); {reading_remedy(path, '')}"
        ) from error
    return rasterio.open(str(path), opener=url_to_fs(str(path))[0])


@contextmanager
def raster_named(path: Path | str, what: str = "cannot be read") -> Iterator[None]:
    """Turn any error of reading a raster into an InputError with its path."""
    try:
        yield
    except (RasterioError, CRSError, ProjError, UnicodeDecodeError) as error:
        reason = printable(" ".join(str(error).split()))
        raise InputError(f"{path}: {what} ({reason}); give a readable raster") from error
