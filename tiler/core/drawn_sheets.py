"""Sheets that the user drew as polygons."""

from __future__ import annotations

from dataclasses import dataclass, field

from tiler.core.area import Area
from tiler.core.records import NOT_IN_DIGEST


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


@dataclass(frozen=True)
class StoredAreas:
    """Some of the areas that the store keeps under one name.

    Attributes
    ----------
    keys : tuple of str
        Keys of the areas.
    name : str
        Name in the store. It changes with every sheet, so it is not in the digest of a task.
    """

    keys: tuple[str, ...]
    name: str = field(metadata=NOT_IN_DIGEST)
