"""Stage grid: heights on the TIN of the ground points, and other rasters, block by block."""

from tiler.grid.above import (
    ABOVE_M,
    BELOW_M,
    CELLS_PER_BLOCK,
    MIN_PLACE_M2,
    AboveBlock,
    above_block,
)
from tiler.grid.below_canopy import CROWNS_REACH_M, BelowCanopy, below_canopy
from tiler.grid.blank import BlankBlocks, blank_blocks
from tiler.grid.block import full_halo, grid_block, grid_blocks
from tiler.grid.bridges.examine import (
    ExamineDecks,
    FindDeckCells,
    examine_decks,
    examined_bounds,
    find_deck_cells,
)
from tiler.grid.canopy import CanopyBlock, canopy_block, canopy_reach_cells
from tiler.grid.coarse import blocks_of
from tiler.grid.coverage import (
    NO_PIECE,
    CloseBlock,
    SurveyBlock,
    close_block,
    occupancy_block,
    survey_block,
)
from tiler.grid.density import density_block
from tiler.grid.derived import DeriveBlock, derive_block
from tiler.grid.distance import DistanceBlock, distance_block
from tiler.grid.edits import CountEditedPoints, count_edited_points
from tiler.grid.ground import GroundSelection
from tiler.grid.highest import reach_pixels
from tiler.grid.holes import CELL_PIXELS
from tiler.grid.mask import MaskBlock, mask_block
from tiler.grid.outline import OutlineBlock, outline_block
from tiler.grid.sigma import SigmaBlock, sigma_block
from tiler.grid.sigma_measures import reach_of
from tiler.grid.surface import SurfaceBlock, surface_block
from tiler.grid.thinning import max_points_in_bucket
from tiler.grid.voids import FillBlock, FindVoids, Void, VoidRasters, fill_block, find_voids
from tiler.grid.water_crowns import CrownsBlock, crowns_block
from tiler.grid.water_find import DescribeBody, describe_body
from tiler.grid.water_finish import FinishWater, finish_water
from tiler.grid.water_ground import GroundCells, ground_cells
from tiler.grid.water_level import LevelWater, level_water
from tiler.grid.water_planes import (
    CountPlaneRims,
    KeepPlanes,
    count_plane_rims,
    find_planes,
    keep_planes,
)
from tiler.grid.water_search import (
    CountRims,
    FindAreas,
    KeepAreas,
    Sources,
    count_rims,
    find_areas,
    keep_areas,
)
from tiler.grid.work import GridBlock, GridBlocks, PointsBlock

__all__ = [
    "ABOVE_M",
    "BELOW_M",
    "CELLS_PER_BLOCK",
    "CELL_PIXELS",
    "CROWNS_REACH_M",
    "MIN_PLACE_M2",
    "NO_PIECE",
    "AboveBlock",
    "BelowCanopy",
    "BlankBlocks",
    "CanopyBlock",
    "CloseBlock",
    "CountEditedPoints",
    "CountPlaneRims",
    "CountRims",
    "CrownsBlock",
    "DeriveBlock",
    "DescribeBody",
    "DistanceBlock",
    "ExamineDecks",
    "FillBlock",
    "FindAreas",
    "FindDeckCells",
    "FindVoids",
    "FinishWater",
    "GridBlock",
    "GridBlocks",
    "GroundCells",
    "GroundSelection",
    "KeepAreas",
    "KeepPlanes",
    "LevelWater",
    "MaskBlock",
    "OutlineBlock",
    "PointsBlock",
    "SigmaBlock",
    "Sources",
    "SurfaceBlock",
    "SurveyBlock",
    "Void",
    "VoidRasters",
    "above_block",
    "below_canopy",
    "blank_blocks",
    "blocks_of",
    "canopy_block",
    "canopy_reach_cells",
    "close_block",
    "count_edited_points",
    "count_plane_rims",
    "count_rims",
    "crowns_block",
    "density_block",
    "derive_block",
    "describe_body",
    "distance_block",
    "examine_decks",
    "examined_bounds",
    "fill_block",
    "find_areas",
    "find_deck_cells",
    "find_planes",
    "find_voids",
    "finish_water",
    "full_halo",
    "grid_block",
    "grid_blocks",
    "ground_cells",
    "keep_areas",
    "keep_planes",
    "level_water",
    "mask_block",
    "max_points_in_bucket",
    "occupancy_block",
    "outline_block",
    "reach_of",
    "reach_pixels",
    "sigma_block",
    "surface_block",
    "survey_block",
]
