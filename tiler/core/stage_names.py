"""Titles of the stages in progress and log. Store, run.json and events use the keys of the stages."""

from __future__ import annotations

from collections.abc import Sequence

FILTER = "filter"
"""Prefix of the keys of the method's passes. The number of the pass follows."""
GRID = "grid-"
"""Prefix of the keys of the rasters. The name of the raster follows."""

_TITLES = {
    "identify": "check inputs for changes",
    "spool": "read the clouds",
    "assemble": "sort the points",
    "deck-cells": "find bridges",
    "decks": "examine possible bridges",
    "edits": "examine the corrections",
    "water-search": "find water",
    "water": "find water levels",
    "sheets": "find sheets with heights",
    "verify": "check results for changes",
    "export": "write the files",
    "mosaic": "write the mosaics",
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
