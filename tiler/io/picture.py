"""PNG pictures from arrays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rasterio.io import MemoryFile

from tiler.io.atomic_files import atomic_path
from tiler.io.geotiff import any_place, raster_errors

DEFLATE_LEVEL = 4
"""Compression level of PNGs, with a third of the time of the usual level 6 and files a few
percent larger."""


def png_bytes(rgba: npt.NDArray[np.uint8]) -> bytes:
    """Return the bytes of a PNG of a picture, uint8 (height, width, 4): red, green, blue, opacity."""
    return _encoded(np.moveaxis(rgba, -1, 0), None)


def palette_png_bytes(
    values: npt.NDArray[np.uint8], colours: Mapping[int, tuple[int, int, int]]
) -> bytes:
    """Return the bytes of a PNG with a palette, for a picture of few colours.

    Parameters
    ----------
    values : uint8, shape (height, width)
        Value of each pixel. 0 is transparent.
    colours : mapping of int to (red, green, blue)
        Colour of each value.
    """
    table = {value: (*colour, 255) for value, colour in colours.items()}
    return _encoded(values[None], {**table, 0: (0, 0, 0, 0)})


def _encoded(
    bands: npt.NDArray[np.uint8], colours: Mapping[int, tuple[int, int, int, int]] | None
) -> bytes:
    count, height, width = bands.shape
    profile = {
        "driver": "PNG",
        "height": height,
        "width": width,
        "count": count,
        "dtype": "uint8",
    }
    profile["ZLEVEL"] = DEFLATE_LEVEL
    with any_place(), MemoryFile() as memory:
        with memory.open(**profile) as picture:
            picture.write(bands)
            if colours is not None:
                picture.write_colormap(1, colours)
        return bytes(memory.read())


def write_png(path: Path, rgba: npt.NDArray[np.uint8]) -> None:
    """Write a picture as a PNG, which appears when it is complete. Raise ProcessingError if this fails."""
    with raster_errors(path), atomic_path(path) as partial:
        partial.write_bytes(png_bytes(rgba))
