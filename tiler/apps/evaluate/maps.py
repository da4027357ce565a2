"""Error maps: the kind and the share of errors per cell, as GeoTIFF and PNG."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
import rasterio
from rasterio.errors import RasterioError
from rasterio.windows import Window

from ptd.arrays import Int64, UInt8
from tiler.apps.difference_statistics import summed
from tiler.core.points import GROUND
from tiler.core.raster import BLOCK_PIXELS
from tiler.errors import ConfigError
from tiler.io.atomic_files import atomic_path
from tiler.io.raster_files import (
    CACHE_BYTES,
    any_place,
    raster_errors,
    tiled_profile,
    write_png,
)

RIGHT = 0
"""Code of a cell in which all points are right."""
TYPE_1 = 1
"""Code of a cell in which ground is lost."""
TYPE_2 = 2
"""Code of a cell in which objects are labelled ground."""
BOTH = 3
"""Code of a cell with both kinds of errors."""
NONE = 255
"""Code of a cell without a judged point, and nodata value of all bands."""

BANDS = (
    "code: 0 right, 1 type I (ground lost), 2 type II (object taken), 3 both",
    "type I, percent of the cell's points",
    "type II, percent of the cell's points",
)
MAX_CELLS = 1 << 31
"""Maximum number of cells of a map, which distant stray points would make arbitrarily large."""
MAX_PICTURE = 4000
"""Maximum side of a PNG in pixels. Larger maps are drawn in larger cells."""

_COLOURS = {
    RIGHT: (205, 205, 200, 255),
    TYPE_1: (214, 39, 40, 255),
    TYPE_2: (31, 90, 200, 255),
    BOTH: (148, 60, 180, 255),
    NONE: (0, 0, 0, 0),
}
"""Colours of the codes. Red and blue are those of figure 12 of Chen 2023."""


class ErrorGrid:
    """Counts of all points and of wrong points per cell.

    Memory grows with the number of occupied cells.

    Parameters
    ----------
    cell : Fraction
        Side of a cell in units of the CRS. The lattice is anchored at coordinate 0.
    ignore : sequence of int
        Reference classes that are left out.
    """

    def __init__(self, cell: Fraction, ignore: Sequence[int]) -> None:
        self.cell = cell
        self._left_out = np.zeros(256, np.bool_)
        self._left_out[list(ignore)] = True
        self.clear()

    def clear(self) -> None:
        """Remove all points."""
        self.places: Int64 = np.empty((2, 0), np.int64)
        self.counts: Int64 = np.empty((3, 0), np.int64)

    def add(self, place: Int64, per_unit: int, labels: UInt8, truth: UInt8) -> None:
        """Count points and their errors.

        Parameters
        ----------
        place : int64, shape (2 or more, n)
            Coordinates x, y and others in counts. Only x and y are used.
        per_unit : int
            Counts per unit of the CRS.
        labels, truth : uint8, shape (n,)
            ASPRS classes: the labels to judge, and the reference classes.
        """
        seen = ~self._left_out[truth]
        side = self.cell * per_unit
        cells = (place[:2, seen] * side.denominator) // side.numerator
        lost = (truth[seen] == GROUND) & (labels[seen] != GROUND)
        taken = (truth[seen] != GROUND) & (labels[seen] == GROUND)
        counts = np.stack((np.ones(lost.size, np.int64), lost, taken)).astype(np.int64)
        self.places, self.counts = summed(
            np.concatenate((self.places, cells), axis=1),
            np.concatenate((self.counts, counts), axis=1),
        )

    def coarser(self, factor: int) -> ErrorGrid:
        """Return the counts in cells whose sides are ``factor`` times as long."""
        grid = ErrorGrid(self.cell * factor, np.flatnonzero(self._left_out).tolist())
        grid.places, grid.counts = summed(self.places // factor, self.counts)
        return grid

    @property
    def extent(self) -> tuple[int, int, int, int]:
        """Westernmost column, northernmost row, width and height of the map, in cells."""
        low, high = self.places.min(axis=1), self.places.max(axis=1)
        return int(low[0]), int(high[1]), int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1

    def bands(self, first_row: int, rows: int) -> UInt8:
        """Return `BANDS` for ``rows`` rows from ``first_row``, uint8, shape (3, rows, width).

        Rows are counted from the north.
        """
        west, north, width, _ = self.extent
        bands = np.full((3, rows, width), NONE, np.uint8)
        row = north - self.places[1] - first_row
        here = (row >= 0) & (row < rows)
        points, lost, taken = self.counts[:, here]
        at = (row[here], self.places[0, here] - west)
        bands[0][at] = (lost > 0) * TYPE_1 + (taken > 0) * TYPE_2
        for band, wrong in ((1, lost), (2, taken)):
            bands[band][at] = np.ceil(100 * wrong / points).astype(np.uint8)
        return bands


def validate_map_files(folder: Path, names: Sequence[str]) -> None:
    """Raise ConfigError if a file with the name of an error map is not an error map."""
    for tif, png in ((folder / f"{name}.tif", folder / f"{name}.png") for name in names):
        there = [path for path in (tif, png) if os.path.lexists(path)]
        if there and not _is_map(tif):
            raise ConfigError(
                f"{there[0]}: already exists and is not a map of errors; give another folder with --maps"
            )


def _is_map(tif: Path) -> bool:
    try:
        with any_place(), rasterio.open(tif) as raster:
            return tuple(raster.descriptions) == BANDS
    except RasterioError:
        return False


def write_error_map(grid: ErrorGrid, folder: Path, name: str, crs: str | None) -> list[str]:
    """Write ``<folder>/<name>.tif`` (bands of `BANDS`, nodata 255) and a PNG of its codes.

    Parameters
    ----------
    grid : ErrorGrid
    folder : Path
        Folder of the map, which is made if necessary.
    name : str
    crs : str or None
        WKT or authority code.

    Returns
    -------
    list of str
        Paths of the files, or an empty list if no point was judged.

    Raises
    ------
    ConfigError
        The map has too many cells.
    ProcessingError
        The files cannot be written.
    """
    if grid.places.shape[1] == 0:
        return []
    _, _, width, height = grid.extent
    if width * height > MAX_CELLS:
        raise ConfigError(
            f"{name}: an error map of {width} x {height} cells is too large; use larger --map-cell"
        )
    tif, png = folder / f"{name}.tif", folder / f"{name}.png"
    with raster_errors(folder):
        tif.parent.mkdir(parents=True, exist_ok=True)
    _write_geotiff(grid, tif, crs)
    factor = math.ceil(max(width, height) / MAX_PICTURE)
    small = grid.coarser(factor) if factor > 1 else grid
    table = np.zeros((256, 4), np.uint8)
    for code, colour in _COLOURS.items():
        table[code] = colour
    write_png(png, table[small.bands(0, small.extent[3])[0]])
    return [str(tif), str(png)]


def _write_geotiff(grid: ErrorGrid, path: Path, crs: str | None) -> None:
    west, north, width, height = grid.extent
    side = float(grid.cell)
    transform = (side, 0.0, float(west * grid.cell), 0.0, -side, float((north + 1) * grid.cell))
    profile = {
        "count": len(BANDS),
        "dtype": "uint8",
        "nodata": NONE,
        "crs": crs,
        "compress": "deflate",
    }
    with (
        any_place(),
        rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES),
        raster_errors(path),
        atomic_path(path) as partial,
        rasterio.open(
            partial, "w", **tiled_profile(height, width, transform), **profile
        ) as raster,
    ):
        for row in range(0, height, BLOCK_PIXELS):
            rows = min(BLOCK_PIXELS, height - row)
            raster.write(grid.bands(row, rows), window=Window(0, row, width, rows))
        for band, text in enumerate(BANDS, start=1):
            raster.set_band_description(band, text)
