"""Basic types: units, frames, lattices, points, rasters, classes, products. Numpy only, and pyproj for CRS."""
