"""Grid: heights at pixel centres on the TIN of the merged ground points, and what follows, block by block."""

from tiler.grid.block import full_halo, grid_block
from tiler.grid.density import density_block
from tiler.grid.derived import derive_block
from tiler.grid.distance import distance_block
from tiler.grid.surface import reach_pixels, surface_block

__all__ = [
    "density_block",
    "derive_block",
    "distance_block",
    "full_halo",
    "grid_block",
    "reach_pixels",
    "surface_block",
]
