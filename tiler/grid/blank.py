"""Deletion of the stored pixels of blocks of a raster."""

from __future__ import annotations

from dataclasses import dataclass

from tiler.core.raster import Block
from tiler.grid.records import BlankRecord
from tiler.store import open_store


@dataclass(frozen=True)
class BlankBlocks:
    """Arguments of `blank_blocks`: a raster in the store and the blocks to delete."""

    name: str
    blocks: tuple[Block, ...]


def blank_blocks(store_url: str, work: BlankBlocks) -> BlankRecord:
    """Delete the stored pixels of blocks, which then read as the fill value.

    This is a `tiler.schedule.task.Work`.

    """
    open_store(store_url).erase_blocks(work.name, work.blocks)
    return BlankRecord(len(work.blocks))
