"""Grid: heights at pixel centres on the TIN of the merged ground points, and what follows, block by block."""

from tiler.grid.block import full_halo, grid_block
from tiler.grid.density import density_block
from tiler.grid.derived import derive_block

__all__ = ["density_block", "derive_block", "full_halo", "grid_block"]
