"""A store with ground points, and its raster gridded in blocks."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tiler.core.lattice import Bounds, CoordFrame, Lattice
from tiler.core.points import PointBlock, pack_origin
from tiler.core.products import Read
from tiler.core.raster import Block, RasterSpec
from tiler.grid.block import block_heights, grid_block
from tiler.grid.records import Facets, GridBlock, GroundSelection
from tiler.grid.steps import MakeBlock, Sources, run_block
from tiler.store import StoreMeta, TileStore, create_store

FINAL = GroundSelection("final")
"""Ground is what the scene's labels say."""


NO_FACETS = Facets(data=Bounds(0, 0, 1, 1), max_edge=Fraction(1), halo=0)


def sources_of(pixels: RasterSpec, **given: Any) -> Sources:
    """Return what the reads of steps have in common, by default with the products' raster for all rasters."""
    usual = {"rule": FINAL, "coarse": pixels, "canopy_grid": pixels, "facets": NO_FACETS}
    return Sources(pixels=pixels, **{**usual, **given})


def make_block(
    store: TileStore,
    name: str,
    work: Callable[..., Any],
    reads: dict[str, Read],
    spec: RasterSpec,
    block: Block,
    fill: float = 0.0,
    sources: Sources | None = None,
    **values: Any,
) -> Mapping[str, Any]:
    """Make one block of a raster by the runner of steps, and return its counts."""
    task = MakeBlock(
        name=name,
        work=work,
        reads=reads,
        spec=spec,
        block=block,
        values=values,
        fill=fill,
        sources=sources or sources_of(spec),
    )
    return run_block(store, task=task)


@dataclass(frozen=True)
class Scene:
    """A filled store, and the bounds of all its points."""

    store: TileStore
    data: Bounds

    def grid(
        self, size: Fraction, block: int = 512, **options: Any
    ) -> tuple[np.ndarray, list[dict]]:
        """Heights of the raster of ``size`` counts a pixel, gridded block by block, and the records."""
        spec = RasterSpec.covering(Lattice(size), self.data)
        heights, records = np.full((spec.height, spec.width), np.nan, np.float32), []
        for b in spec.blocks(block):
            part, record = block_heights(self.store, self.work("", spec, b, **options))
            heights[b.row : b.row + b.height, b.col : b.col + b.width] = part
            records.append(record)
        return heights, records

    def grid_into_store(self, name: str, size: Fraction, **options: Any) -> RasterSpec:
        """The same as a raster of the store, as a run makes it."""
        spec = RasterSpec.covering(Lattice(size), self.data)
        self.store.create_raster(name, spec)
        for b in spec.blocks(512):
            work = self.work(name, spec, b, **{"halo": 10_000, **options})
            record = grid_block(self.store, work=work)
            json.dumps(record.to_json())
        return spec

    def work(self, name: str, spec: RasterSpec, block: Block, **options: Any) -> GridBlock:
        """What makes a block of the terrain, with a limit of 100 m, unless the options say otherwise."""
        limit = Fraction(options.pop("max_edge", 100_000))
        given = {"halo": 0, "rule": FINAL, **options}
        return GridBlock(
            name=name, spec=spec, block=block, data=self.data, max_edge=limit, **given
        )


@pytest.fixture
def make_scene(tmp_path: Path) -> Callable[..., Scene]:
    """Build a scene from absolute counts, int64 (n, 3)."""
    made: list[Scene] = []

    def make(
        xyz: np.ndarray,
        labels: np.ndarray | None = None,
        flags: np.ndarray | None = None,
        frame: CoordFrame | None = None,
        bucket: int = 40_000,
    ) -> Scene:
        frame = frame or CoordFrame()
        labels = np.full(len(xyz), 2, np.uint8) if labels is None else labels
        flags = np.zeros(len(xyz), np.uint8) if flags is None else flags
        lattice = Lattice(Fraction(bucket))
        meta = StoreMeta(
            frame=frame, bucket=lattice, fine=Lattice(Fraction(bucket, 40)), has_rgb=False
        )
        store = create_store(str(tmp_path / f"s{len(made)}.zarr"), meta)
        low, high = xyz[:, :2].min(0), xyz[:, :2].max(0) + 1
        data = Bounds(int(low[0]), int(low[1]), int(high[0]), int(high[1]))
        x, y = xyz[:, 0].astype(np.int64), xyz[:, 1].astype(np.int64)
        local = np.stack((x - frame.origin[0], y - frame.origin[1], xyz[:, 2])).astype(np.int32)
        inside = {
            cell: np.flatnonzero((lattice.index(x) == cell.ix) & (lattice.index(y) == cell.iy))
            for cell in lattice.cells(data)
        }
        inside = {cell: rows for cell, rows in inside.items() if len(rows)}
        store.allocate({cell: len(rows) for cell, rows in inside.items()})
        infos = {}
        for cell, rows in inside.items():
            ones, origin = (
                np.ones((2, len(rows)), np.uint8),
                pack_origin(0, rows.astype(np.int64)),
            )
            block = PointBlock(local[:, rows], ones[0], flags[rows], ones, None, origin)
            infos[cell] = store.write_bucket(cell, block, 0)
        store.publish_index(infos)
        for cell, rows in inside.items():
            store.write_labels("final", cell, labels[rows])
        made.append(Scene(store, data))
        return made[-1]

    return make
