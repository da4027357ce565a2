"""Basic types: units, frames, lattices, points, rasters, classes, products.

They need only numpy, pyproj for CRS, and shapely for indices and lines.
"""
