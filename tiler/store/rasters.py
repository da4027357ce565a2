"""Rasters: one chunk per block, so that each block has one writer; what was never written is nodata."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from tiler.core.raster import BLOCK_PIXELS, Block
from tiler.errors import StoreError
from tiler.store import arrays, layout
from tiler.store.storage import Storage


def create_raster(storage: Storage, name: str, height: int, width: int, fill: float) -> None:
    """Make a raster, or keep the one that is there if it has this shape and fill: for the coordinator."""
    path, kind = layout.raster_path(name), layout.raster_kind(fill)
    found = arrays.find_array(storage, path, kind)
    if found is not None and found.shape == (height, width) and found.fill_value == np.float32(fill):
        return
    storage.delete_folder(path)
    arrays.create_array(storage, path, (height, width), kind)


def open_raster(storage: Storage, name: str) -> arrays.ZarrArray:
    """The raster's array; StoreError where there is none."""
    return arrays.open_array(storage, layout.raster_path(name), layout.raster_kind(0.0))


def write_block(
    storage: Storage, array: arrays.ZarrArray, block: Block, values: npt.NDArray[np.float32]
) -> None:
    """Write a whole block: one chunk, or what the raster's edge leaves of it.

    Raises
    ------
    StoreError
        The block is not a chunk of the raster, or ``values`` have another shape.
    """
    height, width = array.shape
    whole = (min(BLOCK_PIXELS, height - block.row), min(BLOCK_PIXELS, width - block.col))
    aligned = block.row % BLOCK_PIXELS == 0 and block.col % BLOCK_PIXELS == 0
    if not aligned or (block.height, block.width) != whole or values.shape != whole:
        raise StoreError(
            f"{array.path}: block {block.name} is no chunk; blocks are {BLOCK_PIXELS} pixels wide"
        )
    arrays.write(storage, array, _window(block), values.astype(np.float32, copy=False))


def read_block(storage: Storage, array: arrays.ZarrArray, block: Block) -> npt.NDArray[np.float32]:
    """Any window of the raster, float32 (height, width); StoreError where it reaches beyond."""
    height, width = array.shape
    if block.row < 0 or block.col < 0 or block.row + block.height > height or block.col + block.width > width:
        raise StoreError(f"{array.path}: block {block.name} reaches beyond {height} x {width} pixels")
    return arrays.read(storage, array, _window(block))


def stored_blocks(storage: Storage, name: str) -> set[tuple[int, int]]:
    """Row and column of the north-west pixel of each block that a chunk is stored for; the others hold the fill."""
    folder = f"{layout.raster_path(name)}/c"
    return {
        (int(row) * BLOCK_PIXELS, int(col) * BLOCK_PIXELS)
        for row in storage.names(folder)
        for col in storage.names(f"{folder}/{row}")
        if row.isdigit() and col.isdigit()
    }


def erase_blocks(storage: Storage, name: str, blocks: Iterable[Block]) -> None:
    """Remove the chunks of some blocks, which then hold the fill."""
    for block in blocks:
        chunk = f"c/{block.row // BLOCK_PIXELS}/{block.col // BLOCK_PIXELS}"
        storage.delete(f"{layout.raster_path(name)}/{chunk}")


def _window(block: Block) -> tuple[slice, slice]:
    return slice(block.row, block.row + block.height), slice(block.col, block.col + block.width)
