"""Stage grid: heights on the TIN of the ground points, and other rasters, block by block."""
