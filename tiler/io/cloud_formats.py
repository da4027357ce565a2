"""Formats of clouds: their suffixes, and functions that open each as the bytes of a LAS or LAZ file.

All other modules read these bytes (`tiler.io.las`), so a new format is a row and a function.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import BinaryIO, NamedTuple

from tiler.core.words import alternatives
from tiler.io.cloud_reading import BLOCK_BYTES, open_location
from tiler.io.locations import without_query


class CloudFormat(NamedTuple):
    """Name of a format, and the function that opens a file, with the parameters of `open_location`."""

    name: str
    open: Callable[[Path, int, Sequence[tuple[int, int]]], BinaryIO]

    @property
    def is_las(self) -> bool:
        """Whether a file is LAS or LAZ itself."""
        return self.open is open_location


FORMATS = {
    ".las": CloudFormat("LAS", open_location),
    ".laz": CloudFormat("LAZ", open_location),
}
SUFFIXES = tuple(FORMATS)
FORMAT_NAMES = alternatives([row.name for row in FORMATS.values()])
"""Names of all formats for messages: ``LAS or LAZ``."""


def format_of(path: Path) -> CloudFormat:
    """Return the format of a cloud by its suffix. A file with an unknown suffix can only be LAS or LAZ."""
    suffix = Path(without_query(str(path))).suffix.lower()
    return FORMATS.get(suffix, FORMATS[".las"])


def open_cloud(
    path: Path, block_bytes: int = BLOCK_BYTES, parts: Sequence[tuple[int, int]] = ()
) -> BinaryIO:
    """Open a cloud as the bytes of a LAS or LAZ file."""
    return format_of(path).open(path, block_bytes, parts)
