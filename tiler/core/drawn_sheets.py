"""Sheets that the user drew as polygons."""

from __future__ import annotations

from dataclasses import dataclass

from tiler.core.area import Area


@dataclass(frozen=True)
class DrawnSheet:
    """Sheet that the user drew.

    Attributes
    ----------
    name : str
        Value of the polygon in the field of names.
    area : Area
    earlier : tuple of str
        Keys of the areas before it in the file that overlap it. A pixel of both belongs to the earlier one.
    """

    name: str
    area: Area
    earlier: tuple[str, ...] = ()
