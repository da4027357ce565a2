"""Holes filled from their rims, and the mask that says so: true on planes, blocks do not show."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from tests.scenes.ground_points import plane_points
from tests.tiler.grid.conftest import Scene, make_block, sources_of
from tiler.core.lattice import Lattice
from tiler.core.products import FILLED, HOLE, INTERPOLATED, MEASURED, OUTSIDE, Read
from tiler.core.raster import NODATA, Block, RasterSpec
from tiler.grid.coarse import Piece, coarse_raster
from tiler.grid.coverage import NO_PIECE, margin_of, occupancy, open_areas, survey
from tiler.grid.derived import mask as mask_of
from tiler.grid.tasks.steps import outside_of
from tiler.grid.voids import PART_PIXELS, Void, fill_voids, find_voids

SIDE, LIMIT = 240_000, 16_000


Fill = Callable[[Block], Any]
Filled = tuple[Scene, RasterSpec, RasterSpec, Fill, np.ndarray]


@pytest.fixture
def filled(make_scene, monkeypatch: pytest.MonkeyPatch) -> Filled:
    """A plane with two lakes and a notch, its pixels of 1 m and its cells; what fills a block, and its true heights."""
    return scene_with_holes(make_scene, monkeypatch, 1)


def scene_with_holes(make_scene, monkeypatch: pytest.MonkeyPatch, pixel_m: int) -> Filled:
    monkeypatch.setattr("tiler.grid.voids.PART_PIXELS", 40)
    xyz = plane_points(40_000, SIDE)
    x, y = xyz[:, 0], xyz[:, 1]
    lakes = (x - 70_000) ** 2 + (y - 80_000) ** 2 < 40_000**2
    lakes |= (abs(x - 150_000) < 20_000) & (abs(y - 60_000) < 30_000)
    notch = (x > 140_000) & (y > 120_000)
    scene = make_scene(xyz[~(lakes | notch)])
    spec = scene.grid_into_store("dtm", Fraction(1000 * pixel_m), max_edge=str(LIMIT))
    coarse = coarse_raster(Lattice(Fraction(2000)), scene.data)
    gap = LIMIT / 2000
    for name in ("occupancy", "survey", "voids"):
        scene.store.create_raster(name, coarse, 0)
    scene.store.create_raster("open", coarse, NO_PIECE)
    (b,) = coarse.blocks(512)
    sources = sources_of(spec, coarse=coarse)

    def make(name: str, work: Any, reads: dict[str, Read], **values: Any) -> Any:
        return make_block(
            scene.store, name, work, reads, coarse, b, NO_PIECE, sources, **values
        )

    make("occupancy", occupancy, {"points": Read("points")})
    reads = {"occupancy": Read("numbers:occupancy", margin_of(gap))}
    closed = make("open", open_areas, reads, gap=gap, max_gap=gap, marks_bare=False)
    outside, empty = outside_of({(0, 0): closed["sides"]})
    assert not empty
    reads = {
        "opened": Read("raster:open", 1),
        "place": Read("place"),
        "products": Read("products"),
    }
    make("survey", survey, reads, outside=outside[0, 0], empty=())
    margin = math.floor(spec.lattice.size / coarse.lattice.size)
    reads = {
        "heights": Read("pixels:dtm"),
        "survey": Read("numbers:survey", margin),
        "place": Read("place"),
    }
    found = make("voids", find_voids, reads)
    assert found["labels"] == 2
    voids = tuple(Void((Piece(0, 0, n + 1),), "") for n in range(found["labels"]))

    def fill(block: Block) -> Any:
        reads = {
            "heights": Read("pixels:dtm"),
            "cells": Read("coarse:voids"),
            "place": Read("place"),
        }
        return make_block(
            scene.store, "filled", fill_voids, reads, spec, block, NODATA, sources, voids=voids
        )

    for name in ("filled", "mask"):
        scene.store.create_raster(name, spec, NODATA if name == "filled" else OUTSIDE)
    row, col = np.mgrid[: spec.height, : spec.width]
    truth = 50 + pixel_m * ((spec.west + col + 0.5) / 4 - (spec.north - row - 0.5) / 8)
    return scene, spec, coarse, fill, truth


def whole(scene: Scene, spec: RasterSpec, name: str) -> np.ndarray:
    return scene.store.read_block(name, Block(0, 0, spec.height, spec.width))


def test_a_plane_comes_back_below_its_lakes(filled) -> None:
    scene, spec, coarse, fill, truth = filled
    (counts,) = [fill(b) for b in spec.blocks(512)]
    before, after = whole(scene, spec, "dtm"), whole(scene, spec, "filled")
    had, has = before != np.float32(NODATA), after != np.float32(NODATA)
    assert np.array_equal(before[had], after[had])
    assert counts["filled"] == has.sum() > had.sum() + 5_000
    assert np.abs(after - truth)[has].max() < 0.002
    x, y = (
        (spec.west + np.arange(spec.width) + 0.5),
        (spec.north - np.arange(spec.height) - 0.5),
    )
    in_lake = (x[None] - 70) ** 2 + (y[:, None] - 80) ** 2 < 30**2
    in_notch = (x[None] > 160) & (y[:, None] > 140)
    assert has[in_lake].all()
    assert not has[in_notch].any()

    def make_mask(delivered: str) -> None:
        scene.store.create_raster("canopy", spec, NODATA)
        reads = {
            "terrain": Read("raster:dtm"),
            "delivered": Read(f"raster:{delivered}"),
            "canopy": Read("raster:canopy"),
            "survey": Read("cells:survey"),
            **{name: Read(name) for name in ("points", "waters", "failed", "area")},
        }
        sources = sources_of(spec, coarse=coarse)
        block = Block(0, 0, spec.height, spec.width)
        make_block(scene.store, "mask", mask_of, reads, spec, block, sources=sources)

    make_mask("filled")
    mask = whole(scene, spec, "mask")
    assert (mask[in_lake & ~had] == FILLED).all()
    assert (mask[in_notch] == OUTSIDE).all()
    assert (np.isin(mask, (MEASURED, INTERPOLATED)) == had).all()
    assert (mask != HOLE).all()
    make_mask("dtm")
    assert np.array_equal(whole(scene, spec, "mask") == HOLE, mask == FILLED)


@pytest.mark.parametrize("pixel_m", [3, 5])
def test_holes_of_pixels_larger_than_a_coarse_cell_are_whole(
    make_scene, monkeypatch: pytest.MonkeyPatch, pixel_m: int
) -> None:
    scene, spec, _, fill, truth = scene_with_holes(make_scene, monkeypatch, pixel_m)
    fill(Block(0, 0, spec.height, spec.width))
    before, after = whole(scene, spec, "dtm"), whole(scene, spec, "filled")
    x, y = (
        (spec.west + np.arange(spec.width) + 0.5),
        (spec.north - np.arange(spec.height) - 0.5),
    )
    in_lake = (x[None] * pixel_m - 70) ** 2 + (y[:, None] * pixel_m - 80) ** 2 < 30**2
    assert (before[in_lake] == np.float32(NODATA)).any()
    assert np.abs(after - truth)[in_lake].max() < 0.003


def test_each_hole_is_one_and_blocks_do_not_show(
    filled, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, spec, _, fill, _ = filled
    pixels: list[np.ndarray] = []
    monkeypatch.setattr(
        scene.store.__class__,
        "write_block",
        lambda self, name, block, values: pixels.append(values),
    )
    fill(Block(0, 0, spec.height, spec.width))
    (one,) = pixels
    for size, chunk in ((64, PART_PIXELS), (101, 33)):
        monkeypatch.setattr("tiler.grid.voids.PART_PIXELS", chunk)
        tiled = np.empty_like(one)
        for b in spec.blocks(size):
            pixels.clear()
            fill(b)
            tiled[b.row : b.row + b.height, b.col : b.col + b.width] = pixels[0]
        assert tiled.tobytes() == one.tobytes()
