"""Rasters of known heights."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tiler.io.raster_files import RasterMetadata, plain_geotiff

Surface = Callable[[np.ndarray, np.ndarray], np.ndarray]


def tilted(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A plane: 100 + 0.3 x - 0.2 y."""
    return 100 + 0.3 * np.asarray(x) - 0.2 * np.asarray(y)


def write_surface(
    path: Path,
    surface: Surface,
    *,
    west: float = 0.0,
    south: float = 0.0,
    side: int = 40,
    size: float = 1.0,
    crs: str | None = "EPSG:25832",
    unit: str = "metre",
    holes: tuple[tuple[int, int], ...] = (),
) -> Path:
    """A square raster of `side` pixels with the surface's heights at pixel centres; `holes` are (row, col)."""
    north = south + side * size
    x, y = np.meshgrid(
        west + (np.arange(side) + 0.5) * size, north - (np.arange(side) + 0.5) * size
    )
    heights = np.asarray(surface(x, y), np.float32)
    for hole in holes:
        heights[hole] = -9999
    return write_heights(path, heights, west, north, size, crs, unit)


def write_heights(
    path: Path,
    heights: np.ndarray,
    west: float = 0.0,
    north: float = 0.0,
    size: float = 1.0,
    crs: str | None = None,
    unit: str = "metre",
) -> Path:
    """A raster of these heights; -9999 means no height."""
    look, transform = RasterMetadata(crs, unit, "z", {}), (size, 0.0, west, 0.0, -size, north)
    with plain_geotiff(path, *heights.shape, transform, look) as raster:
        raster.write(heights.astype(np.float32), 0, 0)
    return path
