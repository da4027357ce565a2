"""Stage grid: heights on the TIN of the ground points, and other rasters, block by block."""

from tiler.grid.block import full_halo, grid_block, grid_blocks
from tiler.grid.coarse import blocks_of
from tiler.grid.ground import GroundSelection
from tiler.grid.holes import CELL_PIXELS
from tiler.grid.thinning import max_points_in_bucket
from tiler.grid.work import GridBlock

__all__ = [
    "CELL_PIXELS",
    "GridBlock",
    "GroundSelection",
    "blocks_of",
    "full_halo",
    "grid_block",
    "grid_blocks",
    "max_points_in_bucket",
]
