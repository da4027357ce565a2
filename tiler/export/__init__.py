"""Export: what people open, made from what the store holds."""

from tiler.export.classified import write_classified
from tiler.export.cog import write_cog
from tiler.export.contours import write_contours, write_spots
from tiler.export.mosaic import write_mosaic

__all__ = ["write_classified", "write_cog", "write_contours", "write_mosaic", "write_spots"]
