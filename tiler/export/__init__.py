"""Export: what people open, made from what the store holds."""

from tiler.export.classified import write_classified
from tiler.export.cog import write_cog
from tiler.export.contours import write_contours, write_spots
from tiler.export.mosaic import write_mosaic
from tiler.export.outline import write_outline
from tiler.export.water import write_water
from tiler.export.work import (
    WriteClassified,
    WriteCog,
    WriteContours,
    WriteMosaic,
    WriteOutline,
    WriteSpots,
    WriteWater,
)

__all__ = [
    "WriteClassified",
    "WriteCog",
    "WriteContours",
    "WriteMosaic",
    "WriteOutline",
    "WriteSpots",
    "WriteWater",
    "write_classified",
    "write_cog",
    "write_contours",
    "write_mosaic",
    "write_outline",
    "write_spots",
    "write_water",
]
