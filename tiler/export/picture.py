"""Pictures for people: PNG from arrays."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import MemoryFile

from tiler.export.geotiff import raster_errors


def png_bytes(rgba: npt.NDArray[np.uint8]) -> bytes:
    """A picture, uint8 of shape (height, width, 4): red, green, blue, opacity, as the bytes of a PNG."""
    height, width, bands = rgba.shape
    profile = {"driver": "PNG", "height": height, "width": width, "count": bands, "dtype": "uint8"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with MemoryFile() as memory:
            with memory.open(**profile) as picture:
                picture.write(np.moveaxis(rgba, -1, 0))
            return bytes(memory.read())


def write_png(path: Path, rgba: npt.NDArray[np.uint8]) -> None:
    """Write a picture as `png_bytes` makes it; it appears when it is whole. Raises ProcessingError."""
    partial = path.with_name(f"{path.name}.partial")
    with raster_errors(path):
        partial.write_bytes(png_bytes(rgba))
        os.replace(partial, path)
