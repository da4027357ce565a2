"""Stage grid: heights on the TIN of the ground points, and other rasters, block by block."""

from tiler.grid.blank import BlankBlocks, blank_blocks
from tiler.grid.block import full_halo, grid_block, grid_blocks
from tiler.grid.bridges.examine import (
    ExamineDecks,
    FindDeckCells,
    examine_decks,
    examined_bounds,
    find_deck_cells,
)
from tiler.grid.coarse import blocks_of
from tiler.grid.edits import CountEditedPoints, count_edited_points
from tiler.grid.ground import GroundSelection
from tiler.grid.holes import CELL_PIXELS
from tiler.grid.thinning import max_points_in_bucket
from tiler.grid.water_find import DescribeBody, describe_body
from tiler.grid.water_level import LevelWater, level_water
from tiler.grid.work import GridBlock, GridBlocks

__all__ = [
    "CELL_PIXELS",
    "BlankBlocks",
    "CountEditedPoints",
    "DescribeBody",
    "ExamineDecks",
    "FindDeckCells",
    "GridBlock",
    "GridBlocks",
    "GroundSelection",
    "LevelWater",
    "blank_blocks",
    "blocks_of",
    "count_edited_points",
    "describe_body",
    "examine_decks",
    "examined_bounds",
    "find_deck_cells",
    "full_halo",
    "grid_block",
    "grid_blocks",
    "level_water",
    "max_points_in_bucket",
]
