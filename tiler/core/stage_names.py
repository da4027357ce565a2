"""Titles of the stages for people; their keys in the store, run.json and the events are others."""

from __future__ import annotations

from collections.abc import Sequence

FILTER, GRID = "filter", "grid-"
"""How the keys of stages begin that are a pass of the method, and a raster."""

_TITLES = {
    "identify": "look whether inputs changed",
    "spool": "read the clouds",
    "assemble": "sort the points",
    "deck-cells": "look for bridges",
    "decks": "look at what may be a bridge",
    "edits": "look at the corrections",
    "water-search": "find water",
    "water": "find how high water stands",
    "verify": "look whether results changed",
    "export": "write the files",
    "mosaic": "write the mosaics",
    "catalogue": "write the catalogue",
}
_RASTERS = {
    "dtm": "terrain",
    "dsm": "surface model",
    "ndsm": "heights above the terrain",
    "occupancy": "where points are",
    "survey": "outline of the survey",
}
_FORMS = {"voids": "voids", "filled": "voids filled", "outlined": "cut at the outline"}


def stage_title(stage: str, passes: Sequence[str] = ()) -> str:
    """A stage in words.

    Parameters
    ----------
    stage : str
        Its key: ``spool``, ``filter3``, ``grid-dtm-outlined``.
    passes : sequence of str
        What each pass of the method does; a pass that is not among them has its number.
    """
    number = stage.removeprefix(FILTER)
    if stage.startswith(FILTER) and number.isdecimal():
        known = int(number) < len(passes)
        return f"filter: {passes[int(number)]}" if known else f"filter, pass {int(number) + 1}"
    if stage.startswith(GRID):
        name, _, form = stage.removeprefix(GRID).partition("-")
        words = f"grid: {_RASTERS.get(name, name)}"
        return f"{words}, {_FORMS.get(form, form)}" if form else words
    return _TITLES.get(stage, stage)
