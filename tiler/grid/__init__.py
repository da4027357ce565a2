"""Grid: heights of a raster's pixels from the ground points of the merged labels.

Imports nothing by itself: take ``tiler.grid.block``.
"""
