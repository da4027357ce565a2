"""Words for texts that users read: numbers with their nouns, lists, names of CRS, titles of stages.

Store, run.json and events use the keys of the stages, progress and log their titles.
"""

from __future__ import annotations

from collections.abc import Sequence


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """Return a number and its noun, like ``1 lake`` or ``2 lakes``. The default plural has an ``s``."""
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {plural or noun + 's'}"


def listed(texts: Sequence[str], limit: int, noun: str = "") -> str:
    """Return the first texts separated by commas, and the number of the others, like ``a, b and 3 more files``.

    Parameters
    ----------
    texts : sequence of str
    limit : int
        Maximum number of texts.
    noun : str
        Plural of the noun after ``more``.
    """
    first = ", ".join(texts[:limit])
    if len(texts) <= limit:
        return first
    return f"{first} and {len(texts) - limit:,} more {noun}".rstrip()


def alternatives(texts: Sequence[str]) -> str:
    """Return texts joined by commas and ``or``, like ``a, b or c``."""
    *others, last = texts
    return f"{', '.join(others)} or {last}" if others else last


def name_in_wkt(wkt: str | None, none: str = "unknown") -> str:
    """Return the name at the beginning of a CRS in WKT, or the text ``none`` if there is no CRS."""
    if wkt is None:
        return none
    return wkt.split('"', 2)[1] if wkt.count('"') > 1 else wkt


FILTER = "filter"
"""Prefix of the keys of the method's passes. The number of the pass follows."""
GRID = "grid-"
"""Prefix of the keys of the rasters. The name of the raster follows."""

_TITLES = {
    "identify": "check inputs for changes",
    "spool": "read the clouds",
    "surveys": "find where each survey has points",
    "assemble": "sort the points",
    "deck-cells": "find bridges",
    "decks": "examine possible bridges",
    "edits": "examine the corrections",
    "water-search": "find water",
    "water": "find water levels",
    "sheets": "find sheets with heights",
    "verify": "check results for changes",
    "export": "write the files",
    "mosaic": "write mosaics and vector files of sheets",
    "catalogue": "write the catalogue",
}
_RASTERS = {
    "dtm": "terrain",
    "dsm": "surface model",
    "ndsm": "heights above the terrain",
    "occupancy": "where points are",
    "canopy": "closed canopy",
    "survey": "outline of the survey",
    "domain": "where water could be",
}
_FORMS = {
    "voids": "voids",
    "filled": "voids filled",
    "outlined": "cut at the outline",
    "below": "terrain below it",
    "above": "where it lies above all returns",
    "left": "objects left in it",
    "open": "gaps",
    "terrain": "terrain in cells",
    "ground": "heights of the cells",
    "areas": "candidates",
    "rims": "land around the candidates",
    "sure": "candidates that are water",
    "planes": "level areas",
    "plane-rims": "land around the level areas",
    "plane-sure": "level areas that are water",
    "cells": "bridges and islands",
}


def stage_title(stage: str, passes: Sequence[str] = ()) -> str:
    """Return the title of a stage.

    Parameters
    ----------
    stage : str
        Key of the stage: ``spool``, ``filter3``, ``grid-dtm-outlined``.
    passes : sequence of str
        Titles of the method's passes. A pass without a title here gets its number as title.
    """
    if stage in _TITLES:
        return _TITLES[stage]
    if stage.startswith(GRID):
        name, _, form = stage.removeprefix(GRID).partition("-")
        title = f"grid: {_RASTERS.get(name, name)}"
        return f"{title}, {_FORMS.get(form, form)}" if form else title
    number = stage.removeprefix(FILTER)
    if not stage.startswith(FILTER) or not number.isdecimal():
        return stage
    if int(number) < len(passes):
        return f"filter: {passes[int(number)]}"
    return f"filter, pass {int(number) + 1}"
