"""Blocks of a raster that hold nothing any more."""

from __future__ import annotations

from typing import Any

from tiler.core.raster import Block
from tiler.store import open_store


def blank_blocks(store_url: str, args: dict[str, Any]) -> dict[str, Any]:
    """Remove what is stored of some blocks, which then are the raster's fill; a `tiler.schedule.task.Work`.

    Parameters
    ----------
    store_url : str
    args : dict
        ``name``: of the raster in the store. ``blocks``: row, col, height, width of each.

    Returns
    -------
    dict
        ``blocks``: how many they were.
    """
    open_store(store_url).erase_blocks(args["name"], [Block(*block) for block in args["blocks"]])
    return {"blocks": len(args["blocks"])}
