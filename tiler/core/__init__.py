"""The nouns: units, frames, lattices, tiles, points, rasters, classes. Numpy only, and pyproj for CRS."""
