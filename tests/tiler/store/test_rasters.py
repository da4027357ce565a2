"""Rasters: blocks written one by one, read in any window."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import zarr

from tests.tiler.store.conftest import pixels
from tiler.core.lattice import Bounds, Lattice
from tiler.core.raster import NODATA, Block, RasterSpec
from tiler.errors import StoreError
from tiler.store import TileStore, open_store
from tiler.store.arrays import write_metadata
from tiler.store.layout import raster_kind
from tiler.store.storage import Storage


def test_blocks_come_back_in_any_window(store: TileStore) -> None:
    spec = RasterSpec.covering(Lattice(1), Bounds(0, 0, 700, 1100))  # type: ignore[arg-type]
    truth = np.random.default_rng(0).normal(size=(spec.height, spec.width)).astype(np.float32)
    store.create_raster("dtm", spec)
    for b in spec.blocks(512):
        store.write_block("dtm", b, truth[b.row : b.row + b.height, b.col : b.col + b.width])
    reader = open_store(store.url)
    for b in [Block(0, 0, 1100, 700), Block(500, 500, 100, 100), Block(1099, 699, 1, 1)]:
        found = reader.read_block("dtm", b)
        assert found.dtype == np.float32
        assert np.array_equal(found, truth[b.row : b.row + b.height, b.col : b.col + b.width])


def test_blocks_that_were_not_written_hold_the_fill_and_need_no_object(
    local_store: TileStore,
) -> None:
    local_store.create_raster("dtm", pixels(600, 600))
    local_store.create_raster("count", pixels(600, 600), fill=0.0)
    objects = local_store.usage().objects
    local_store.write_block(
        "dtm", Block(0, 512, 512, 88), np.full((512, 88), -9999.0, np.float32)
    )
    assert np.all(local_store.read_block("dtm", Block(0, 0, 600, 600)) == -9999.0)
    assert np.all(local_store.read_block("count", Block(0, 0, 600, 600)) == 0.0)
    assert local_store.usage().objects == objects


def test_rasters_of_the_last_four_resolutions_stay_with_their_commits(
    local_store: TileStore,
) -> None:
    block = Block(0, 0, 10, 10)

    def use(resolution: str) -> tuple[float | None, set[str]]:
        """Height of the raster of a resolution, as a worker reads it, and the keys of its commits."""
        local_store.use_rasters(resolution)
        local_store.use_rasters(resolution)
        commits = set(local_store.committed("grid-dtm"))
        worker = open_store(local_store.url)
        return float(worker.read_block("dtm", block)[0, 0]) if commits else None, commits

    def make(height: float) -> None:
        local_store.create_raster("dtm", pixels(10, 10))
        local_store.write_block("dtm", block, np.full((10, 10), height, np.float32))
        local_store.commit("grid-dtm", f"block-{height:g}", "digest", {})

    for resolution, height in (("1", 7.0), ("1/2", 8.0)):
        assert use(resolution) == (None, set())
        make(height)
    for _ in range(2):
        assert use("1") == (7.0, {"block-7"})
        assert use("1/2") == (8.0, {"block-8"})
    for resolution, height in (("2", 9.0), ("3", 10.0), ("4", 11.0)):
        assert use(resolution) == (None, set())
        make(height)
    assert use("1/2") == (8.0, {"block-8"})
    assert use("1") == (None, set())
    assert len(list(Path(local_store.url, "rasters").glob("dtm+*"))) == 3


def test_a_raster_made_again_with_the_same_shape_keeps_its_blocks(
    local_store: TileStore,
) -> None:
    block = Block(0, 0, 10, 10)
    local_store.create_raster("dtm", pixels(10, 10))
    local_store.write_block("dtm", block, np.ones((10, 10), np.float32))
    local_store.create_raster("dtm", pixels(10, 10))
    assert local_store.read_block("dtm", block).all()
    local_store.create_raster("dtm", pixels(10, 11))
    assert np.all(local_store.read_block("dtm", Block(0, 0, 10, 11)) == -9999.0)
    local_store.create_raster("dtm", pixels(10, 11), fill=0.0)
    assert np.all(local_store.read_block("dtm", Block(0, 0, 10, 11)) == 0.0)


def test_a_raster_without_a_position_gets_one_and_keeps_its_blocks(
    local_store: TileStore,
) -> None:
    """Stores of the same schema may have rasters without attributes."""
    block, folder = Block(0, 0, 10, 10), Path(local_store.url, "rasters", "dtm")
    write_metadata(Storage(local_store.url), "rasters/dtm", (10, 10), raster_kind(NODATA))
    local_store.write_block("dtm", block, np.ones((10, 10), np.float32))
    chunk = (folder / "c.0.0").read_bytes()
    assert "spatial:transform" not in zarr.open_array(folder, mode="r").attrs
    assert open_store(local_store.url).read_block("dtm", block).all()
    for west in (0, 7):
        local_store.create_raster("dtm", replace(pixels(10, 10), west=west))
        found = zarr.open_array(folder, mode="r").attrs["spatial:transform"]
        assert found == [1, 0, west, 0, -1, 10]
        assert (folder / "c.0.0").read_bytes() == chunk
        assert open_store(local_store.url).read_block("dtm", block).all()


def test_xarray_opens_rasters_of_several_pixel_sizes_and_extents(store: TileStore) -> None:
    xarray = pytest.importorskip("xarray")
    fine = RasterSpec(Lattice(Fraction(500)), 4, 40, 20, 30)
    moved, coarse = replace(fine, west=6), pixels(10, 15)
    rasters = {"dtm": fine, "dsm": fine, "moved": moved, "mask": fine, "cells": coarse}
    for name, spec in rasters.items():
        store.create_raster(name, spec, 0.0 if name in ("mask", "cells") else NODATA)
    heights = np.arange(600, dtype=np.float32).reshape(20, 30)
    heights[0] = NODATA
    store.write_block("dtm", Block(0, 0, 20, 30), heights)
    with xarray.open_zarr(
        Storage(store.url).zarr_store, group="rasters", consolidated=False
    ) as opened:
        assert set(opened) == set(rasters)
        assert np.isnan(opened["dtm"][0]).all()
        assert np.array_equal(opened["dtm"][1:], heights[1:])
        assert np.isnan(opened["mask"]).all(), "nodata of mask.tif"
        assert (opened["cells"] == 0).all(), "no points in a cell"
        assert opened["dtm"].dims == opened["dsm"].dims
        assert opened["dtm"].dims[0] == opened["moved"].dims[0]
        assert opened["dtm"].dims[1] != opened["moved"].dims[1]
        assert not set(opened["dtm"].dims) & set(opened["cells"].dims)


@pytest.mark.parametrize("is_noise", [False, True])
def test_other_programs_read_a_chunk(local_store: TileStore, is_noise: bool) -> None:
    """GDAL refuses a frame of another size. Blosc refuses a larger one if it could not compress the values."""
    bits = np.random.default_rng(0).integers(0, 2**32, (512, 512), np.uint32)
    values = bits.view(np.float32) if is_noise else bits.astype(np.float32)
    local_store.create_raster("dtm", pixels(512, 512))
    local_store.write_block("dtm", Block(0, 0, 512, 512), values)
    folder = Path(local_store.url, "rasters", "dtm")
    frame = (folder / "c.0.0").read_bytes()[:-4]
    assert bool(frame[2] & 0x2) == is_noise
    assert int.from_bytes(frame[12:16], "little") == len(frame) - 4 * is_noise
    by_zarr = zarr.open_array(folder, mode="r")[:]
    for found in (by_zarr, local_store.read_block("dtm", Block(0, 0, 512, 512))):
        assert found.tobytes() == values.tobytes()


@pytest.mark.parametrize(
    "block",
    [
        Block(0, 0, 512, 100),
        Block(1, 0, 512, 512),
        Block(512, 512, 89, 88),
        Block(0, 0, 600, 600),
    ],
)
def test_a_block_that_shares_a_chunk_is_refused(local_store: TileStore, block: Block) -> None:
    local_store.create_raster("dtm", pixels(600, 600))
    with pytest.raises(StoreError, match="is not a chunk"):
        local_store.write_block("dtm", block, np.zeros((block.height, block.width), np.float32))


def test_values_of_another_shape_and_windows_beyond_are_refused(local_store: TileStore) -> None:
    local_store.create_raster("dtm", pixels(600, 600))
    with pytest.raises(StoreError, match="is not a chunk"):
        local_store.write_block("dtm", Block(512, 512, 88, 88), np.zeros((1, 88), np.float32))
    with pytest.raises(StoreError, match="reaches beyond 600 x 600"):
        local_store.read_block("dtm", Block(512, 512, 89, 88))
    with pytest.raises(StoreError, match="there is no rasters/dsm"):
        local_store.read_block("dsm", Block(0, 0, 1, 1))
