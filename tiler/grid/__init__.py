"""Grid: heights at pixel centres on the TIN of the merged ground points, and what follows, block by block."""

from tiler.grid.blank import blank_blocks
from tiler.grid.block import SMALLEST_PART, full_halo, grid_block, grid_blocks, most_of_bucket
from tiler.grid.bridges import examine_decks, examined, find_deck_cells
from tiler.grid.density import density_block
from tiler.grid.derived import derive_block
from tiler.grid.distance import distance_block
from tiler.grid.edits import survey_edit
from tiler.grid.ground import GroundRule
from tiler.grid.mask import mask_block
from tiler.grid.outline import outline_block
from tiler.grid.surface import DEEP_M, reach_pixels, surface_block
from tiler.grid.survey import blocks_of, occupancy_block, survey_raster
from tiler.grid.voids import fill_block, find_voids
from tiler.grid.water_find import find_bodies
from tiler.grid.water_level import level_water
from tiler.grid.work import (
    BlankBlocks,
    DeriveBlock,
    DistanceBlock,
    ExamineDecks,
    FillBlock,
    FindDeckCells,
    FindWater,
    GridBlock,
    GridBlocks,
    LevelWater,
    MakeSurvey,
    MaskBlock,
    OutlineBlock,
    PointsBlock,
    SurfaceBlock,
    SurveyEdit,
    Void,
    VoidRasters,
)

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
