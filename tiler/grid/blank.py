"""Deletes the stored pixels of blocks of a raster, which then read as its fill value."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tiler.core.raster import Block
from tiler.store import open_store


@dataclass(frozen=True)
class BlankBlocks:
    """Work: delete the stored pixels of some blocks of a raster."""

    name: str
    blocks: tuple[Block, ...]


def blank_blocks(store_url: str, work: BlankBlocks) -> dict[str, Any]:
    """Delete the stored pixels of some blocks, which then read as the fill value; a `tiler.schedule.task.Work`.

    Returns
    -------
    dict
        ``blocks``: their number.
    """
    open_store(store_url).erase_blocks(work.name, work.blocks)
    return {"blocks": len(work.blocks)}
