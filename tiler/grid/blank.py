"""Removes blocks of a raster that are to hold nothing any more."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tiler.core.raster import Block
from tiler.store import open_store


@dataclass(frozen=True)
class BlankBlocks:
    """Blocks of a raster that are to hold nothing any more."""

    name: str
    blocks: tuple[Block, ...]


def blank_blocks(store_url: str, work: BlankBlocks) -> dict[str, Any]:
    """Remove what is stored of some blocks, which then are the raster's fill; a `tiler.schedule.task.Work`.

    Returns
    -------
    dict
        ``blocks``: how many they were.
    """
    open_store(store_url).erase_blocks(work.name, work.blocks)
    return {"blocks": len(work.blocks)}
