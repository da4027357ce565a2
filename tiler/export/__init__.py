"""Export: files for users, made from the contents of the store."""

from tiler.export.bridges import write_bridges
from tiler.export.classified import write_classified
from tiler.export.cog import write_cog
from tiler.export.contours import write_contours, write_spots
from tiler.export.mosaic import write_legend, write_mosaic
from tiler.export.outline import write_outline
from tiler.export.output_files import write_text
from tiler.export.sheets import find_sheets, write_sheet_index
from tiler.export.water import write_water
from tiler.export.work import (
    FindSheets,
    WriteBridges,
    WriteClassified,
    WriteCog,
    WriteContours,
    WriteLegend,
    WriteMosaic,
    WriteOutline,
    WriteSheetIndex,
    WriteSpots,
    WriteText,
    WriteWater,
)

__all__ = [
    "FindSheets",
    "WriteBridges",
    "WriteClassified",
    "WriteCog",
    "WriteContours",
    "WriteLegend",
    "WriteMosaic",
    "WriteOutline",
    "WriteSheetIndex",
    "WriteSpots",
    "WriteText",
    "WriteWater",
    "find_sheets",
    "write_bridges",
    "write_classified",
    "write_cog",
    "write_contours",
    "write_legend",
    "write_mosaic",
    "write_outline",
    "write_sheet_index",
    "write_spots",
    "write_text",
    "write_water",
]
