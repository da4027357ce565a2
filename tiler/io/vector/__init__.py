"""Vector files with the standard library alone: points and polygons of GeoJSON, GeoPackage and Shapefile.

GeoJSON is JSON, a GeoPackage is an SQLite data base and a shapefile a list of records; for other formats a vector
library, which would bring a second GDAL along, does not earn its place: `ogr2ogr` converts them.
"""

from tiler.io.vector.geojson import read_features
from tiler.io.vector.geopackage import Layer, geometry_of, read_layer
from tiler.io.vector.polygons import Polygons, read_polygons

__all__ = ["Layer", "Polygons", "geometry_of", "read_features", "read_layer", "read_polygons"]
