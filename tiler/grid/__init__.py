"""Grid: heights at pixel centres on the TIN of the merged ground points, block by block."""

from tiler.grid.block import full_halo, grid_block

__all__ = ["full_halo", "grid_block"]
