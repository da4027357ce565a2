"""Foreign rasters, read in blocks of bounded size. Any fault in one becomes an error of one line with its path."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from fsspec.core import url_to_fs
from pyproj import CRS
from pyproj.exceptions import ProjError
from rasterio.errors import CRSError, RasterioError

from ptd.arrays import Float64
from tiler.core.crs import split_wkt
from tiler.core.units import METRE, exact_unit, unit_named
from tiler.errors import InputError
from tiler.io.locations import is_url, reading_remedy, state_at
from tiler.io.result_folder import raster_places, read_run
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
        reason, remedy = printable(" ".join(str(error).split())), "give a readable raster"
        if Path(path).is_dir():  # GDAL reads some folders, such as grids of ArcInfo.
            reason = "the folder is not a raster"
            remedy = "give a raster, or a folder with clouds or the results of a run"
        raise InputError(f"{path}: {what} ({reason}); {remedy}") from error


def raster_beside(dtm: Path | str, product: str) -> Path | None:
    """Return the raster of a product that a run wrote next to its DTM, or None."""
    if is_url(dtm):
        return None
    path = Path(dtm)
    run = read_run(str(path.parent))
    pairs = zip(raster_places(run, "dtm"), raster_places(run, product), strict=True)
    found = (path.with_name(other) for terrain, other in pairs if terrain == path.name)
    return next((other for other in found if other.is_file()), None)


BLOCK = 1024
"""Side in pixels of a block. One block per raster is in memory at a time."""


def files_of_raster(path: Path | str) -> list[str]:
    """Return the files of a raster, including the files to which a VRT refers."""
    files, todo = [str(path)], [str(path)]
    while todo:
        try:
            with open_raster(todo.pop()) as raster:
                new = [file for file in raster.files if file not in files]
        except InputError:  # The fault is reported when the raster is read.
            continue
        files += new
        todo += [file for file in new if file.lower().endswith(".vrt")]
    return files


def blocks_with_files(raster: Any, *others: Any) -> Iterator[tuple[int, int, int, int]]:
    """Yield row, column, height and width of the blocks of an open raster.

    Blocks of a VRT are left out if they are not near a file of the VRT or of ``others``,
    rasters on the same lattice. A VRT over the sheets of distant sites has millions of empty
    blocks.
    """
    height, width = raster.shape
    if raster.driver == "VRT" and not (raster.transform.b or raster.transform.d):
        reached: set[tuple[int, int]] = set()
        for each in (raster, *others):
            # The files that contain its pixels.
            is_vrt = each.driver == "VRT"
            files = (
                [path for path in each.files if path != each.name] if is_vrt else [each.name]
            )
            for path in files:
                reached.update(_reached(raster, path))
        block_corners = sorted(reached)
    else:
        block_corners = list(itertools.product(range(0, height, BLOCK), range(0, width, BLOCK)))
    for row, col in block_corners:
        yield row, col, min(BLOCK, height - row), min(BLOCK, width - col)


def _reached(vrt: Any, path: str) -> Iterator[tuple[int, int]]:
    """Yield row and column of the blocks of a VRT that are at most two pixels from a file."""
    with rasterio.open(path) as part:
        x0, y0, x1, y1 = part.bounds
    transform = vrt.transform
    left, right = sorted((x - transform.c) / transform.a for x in (x0, x1))
    top, bottom = sorted((y - transform.f) / transform.e for y in (y0, y1))
    for row in range(
        max(int(top) - 1, 0) // BLOCK * BLOCK, min(int(bottom) + 2, vrt.height), BLOCK
    ):
        for col in range(
            max(int(left) - 1, 0) // BLOCK * BLOCK, min(int(right) + 2, vrt.width), BLOCK
        ):
            yield row, col


def read_heights(raster: Any, row: int, col: int, height: int, width: int) -> Float64:
    """Read a window of an open raster's first band, with NaN without data and beyond the raster.

    Parameters
    ----------
    raster : rasterio data set
    row, col, height, width : int
        First pixel and size of the window in pixels. It may lie partly or wholly beyond the raster.

    Returns
    -------
    float64, shape (height, width)
    """
    heights = np.full((height, width), np.nan)
    top, left = max(row, 0), max(col, 0)
    bottom, right = min(row + height, raster.height), min(col + width, raster.width)
    if top < bottom and left < right:
        with raster_named(raster.name):
            part = raster.read(1, window=((top, bottom), (left, right)), masked=True).astype(
                np.float64
            )
        heights[top - row : bottom - row, left - col : right - col] = part.filled(np.nan)
        if (raster.scales[0], raster.offsets[0]) != (1.0, 0.0):
            heights = heights * raster.scales[0] + raster.offsets[0]
    return heights


def crs_parts(raster: Any) -> tuple[CRS | None, CRS | None]:
    """Return the horizontal CRS and that of the heights of an open raster. Each may be None."""
    return split_wkt(raster.crs.to_wkt() if raster.crs else None)


def vertical_unit(raster: Any) -> Fraction:
    """Return the metres in one unit of an open raster's heights: that of the band, else of the CRS."""
    return unit_named(raster.units[0]) if raster.units[0] else horizontal_unit(raster)


def horizontal_unit(raster: Any) -> Fraction:
    """Return the metres in one unit of an open raster's coordinates, or 1 without a projected CRS."""
    if raster.crs is None or not raster.crs.is_projected:
        return METRE
    return exact_unit(raster.crs.linear_units_factor[1])
