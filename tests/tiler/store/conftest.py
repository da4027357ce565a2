"""Stores of both kinds, and points to put into them."""

from __future__ import annotations

import uuid
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tiler.core.lattice import Cell, CoordFrame, Lattice
from tiler.core.points import PointBlock, pack_origin
from tiler.core.raster import RasterSpec
from tiler.store import BucketInfo, StoreMeta, TileStore, create_store

META = StoreMeta(
    CoordFrame(origin=(-7_000, 11_000)),
    Lattice(Fraction(10_000, 3)),
    Lattice(Fraction(10_000, 9)),
    True,
)


@pytest.fixture
def meta() -> StoreMeta:
    """Buckets of a third of ten thousand counts, a frame with an origin, colours."""
    return META


@pytest.fixture(params=["local", "memory"])
def store_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """A URL without a store yet: a folder, and an object store."""
    return (
        str(tmp_path / "store.zarr")
        if request.param == "local"
        else f"memory://{uuid.uuid4().hex}/store.zarr"
    )


@pytest.fixture
def store(store_url: str, meta: StoreMeta) -> TileStore:
    """A new store of either kind."""
    return create_store(store_url, meta)


@pytest.fixture
def local_store(tmp_path: Path) -> TileStore:
    """A new store in a folder."""
    return create_store(str(tmp_path / "store.zarr"), META)


def pixels(height: int, width: int) -> RasterSpec:
    """A raster of pixels of a thousand counts whose south-west corner is the origin of the CRS."""
    return RasterSpec(Lattice(Fraction(1000)), 0, height, height, width)


def make_points(
    x: np.ndarray, y: np.ndarray, has_rgb: bool = True, seed: int = 0
) -> PointBlock:
    """Points at absolute x, y (int64), every other value random."""
    rng = np.random.default_rng(seed)
    n = len(x)
    origin = META.frame.origin
    return PointBlock(
        np.stack([x - origin[0], y - origin[1], rng.integers(-(2**31) + 1, 2**31, n)]).astype(
            np.int32
        ),
        rng.integers(0, 256, n).astype(np.uint8),
        rng.integers(0, 256, n).astype(np.uint8),
        rng.integers(0, 256, (2, n)).astype(np.uint8),
        rng.integers(0, 65536, (3, n)).astype(np.uint16) if has_rgb else None,
        pack_origin(2**22, rng.permutation(n).astype(np.int64)),
    )


def put_points(
    store: TileStore, block: PointBlock, candidates: float = 0.4
) -> dict[Cell, BucketInfo]:
    """Write and publish points as ingest does; a share of each bucket counts as candidates."""
    x, y = (block.xyz[i].astype(np.int64) + store.meta.frame.origin[i] for i in (0, 1))
    ix, iy = store.meta.bucket.index(x), store.meta.bucket.index(y)
    masks = {
        Cell(i, j): (ix == i) & (iy == j)
        for i, j in sorted(set(zip(ix.tolist(), iy.tolist(), strict=True)))
    }
    store.allocate({cell: int(mask.sum()) for cell, mask in masks.items()})
    infos = {
        cell: store.write_bucket(cell, block.take(mask), round(candidates * int(mask.sum())))
        for cell, mask in masks.items()
    }
    store.publish_index(infos)
    return infos


@pytest.fixture
def filled(local_store: TileStore) -> TileStore:
    """A local store with 2000 points in some buckets."""
    rng = np.random.default_rng(5)
    put_points(local_store, make_points(*rng.integers(-5000, 5000, (2, 2000))))
    return local_store
