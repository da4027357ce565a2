"""Exact, unique, incremental Delaunay TIN and its interpolation. Its arrays are described in `ptd.tin.triangles`."""

from ptd.tin.gridding import KnownWindow, Pixels, TinRaster, pixel_owners, rasterise
from ptd.tin.mesh import MAX_EXTENT, Tin

__all__ = [
    "MAX_EXTENT",
    "KnownWindow",
    "Pixels",
    "Tin",
    "TinRaster",
    "pixel_owners",
    "rasterise",
]
