"""Vector files: reading of features in the CRS of a run, and writing of GeoPackages."""

from tiler.io.vector.opening import CUT
from tiler.io.vector.reading import (
    LINES,
    LINES_AND_POLYGONS,
    POINTS,
    POLYGONS,
    Feature,
    Features,
    Kind,
    read_features,
    read_in_crs,
    warn_outside,
)
from tiler.io.vector.writing import GeoPackage, geopackage

__all__ = [
    "CUT",
    "LINES",
    "LINES_AND_POLYGONS",
    "POINTS",
    "POLYGONS",
    "Feature",
    "Features",
    "GeoPackage",
    "Kind",
    "geopackage",
    "read_features",
    "read_in_crs",
    "warn_outside",
]
