"""Basic types: units, frames, lattices, points, rasters, classes, products.

They need only numpy, and pyproj for CRS.
"""
