"""Removes blocks of a raster that are to hold nothing any more."""

from __future__ import annotations

from typing import Any

from tiler.grid.work import BlankBlocks
from tiler.store import open_store


def blank_blocks(store_url: str, work: BlankBlocks) -> dict[str, Any]:
    """Remove what is stored of some blocks, which then are the raster's fill; a `tiler.schedule.task.Work`.

    Parameters
    ----------
    store_url : str
    work : BlankBlocks

    Returns
    -------
    dict
        ``blocks``: how many they were.
    """
    open_store(store_url).erase_blocks(work.name, work.blocks)
    return {"blocks": len(work.blocks)}
