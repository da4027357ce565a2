"""Grid: heights at pixel centres on the TIN of the merged ground points, and what follows, block by block."""

from tiler.grid.blank import BlankBlocks, blank_blocks
from tiler.grid.block import SMALLEST_PART, full_halo, grid_block, grid_blocks
from tiler.grid.bridges import ExamineDecks, FindDeckCells, examine_decks, examined, find_deck_cells
from tiler.grid.density import density_block
from tiler.grid.derived import DeriveBlock, derive_block
from tiler.grid.distance import DistanceBlock, distance_block
from tiler.grid.edits import SurveyEdit, survey_edit
from tiler.grid.ground import GroundRule
from tiler.grid.mask import MaskBlock, mask_block
from tiler.grid.outline import OutlineBlock, outline_block
from tiler.grid.surface import DEEP_M, SurfaceBlock, reach_pixels, surface_block
from tiler.grid.survey import MakeSurvey, blocks_of, occupancy_block, survey_raster
from tiler.grid.thinning import most_of_bucket
from tiler.grid.voids import FillBlock, Void, VoidRasters, fill_block, find_voids
from tiler.grid.water_find import FindWater, find_bodies
from tiler.grid.water_level import LevelWater, level_water
from tiler.grid.work import GridBlock, GridBlocks, PointsBlock

__all__ = [
    "DEEP_M",
    "SMALLEST_PART",
    "BlankBlocks",
    "DeriveBlock",
    "DistanceBlock",
    "ExamineDecks",
    "FillBlock",
    "FindDeckCells",
    "FindWater",
    "GridBlock",
    "GridBlocks",
    "GroundRule",
    "LevelWater",
    "MakeSurvey",
    "MaskBlock",
    "OutlineBlock",
    "PointsBlock",
    "SurfaceBlock",
    "SurveyEdit",
    "Void",
    "VoidRasters",
    "blank_blocks",
    "blocks_of",
    "density_block",
    "derive_block",
    "distance_block",
    "examine_decks",
    "examined",
    "fill_block",
    "find_bodies",
    "find_deck_cells",
    "find_voids",
    "full_halo",
    "grid_block",
    "grid_blocks",
    "level_water",
    "mask_block",
    "most_of_bucket",
    "occupancy_block",
    "outline_block",
    "reach_pixels",
    "surface_block",
    "survey_edit",
    "survey_raster",
]
