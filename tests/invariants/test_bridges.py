"""Bridges that a run takes out of the terrain: their classes, what is drawn of them, and that nothing else changes."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pyogrio
import pytest
import shapely

from tests.invariants import clouds
from tests.invariants.clouds import CORNER, Cloud
from tests.invariants.runs import all_digests, do, dtm

EAST, NORTH = CORNER
HALF, BED = 5.0, 12.0  # metres: of the deck's width, and of the bed of the valley below it
MIDDLE = 60.0


def valley(x: np.ndarray) -> np.ndarray:
    return 5 - np.clip((np.abs(x - MIDDLE) - BED) / 2, 0, 5)


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A road over a valley, 5 m above its bed; all points are of class 2."""
    rng = np.random.default_rng(5)
    xy = np.round(rng.uniform(0, 120, (40_000, 2)), 3)
    deck = (np.abs(xy[:, 1] - MIDDLE) < HALF) & (valley(xy[:, 0]) > 0)
    z = np.round(50 - np.where(deck, 0, valley(xy[:, 0])) + rng.normal(0, 0.02, len(xy)), 3)
    cloud = Cloud(np.column_stack((xy, z)), np.full(len(xy), 2, np.uint8))
    return clouds.write(
        tmp_path_factory.mktemp("cloud") / "road.laz", cloud, classes=cloud.truth
    )


def test_a_deck_is_left_out_drawn_and_brought_back(cloud: Path, tmp_path: Path) -> None:
    out, settings = tmp_path / "out", {"method": "keep", "resolution": "1"}
    do(cloud, out, **settings)
    with_deck, digests = dtm(out)[0][::-1], all_digests(out)
    assert not (out / "bridges.gpkg").exists()
    result = do(cloud, out, bridges="remove", **settings)
    (fact,) = result.summary["bridges"]
    meta, _, shapes, columns = pyogrio.raw.read(out / "bridges.gpkg")
    (deck,) = shapely.from_wkb(shapes)
    sizes = dict(zip(meta["fields"], (column[0] for column in columns), strict=True))
    assert sizes["width_m"] == pytest.approx(2 * HALF, abs=0.6)
    assert 2 * BED <= sizes["length_m"] <= 2 * BED + 20
    assert sizes["clearance_m"] == pytest.approx(5, abs=0.3)
    assert fact["length_m"] == sizes["length_m"]
    east, north, reach = EAST + MIDDLE, NORTH + MIDDLE, BED + 10
    truth = shapely.box(east - reach, north - HALF, east + reach, north + HALF)
    assert deck.difference(truth.buffer(0.8)).area == 0
    assert deck.intersection(truth).area > 0.7 * truth.area
    y, x = np.mgrid[:120, :120] + 0.5
    true = 50 - valley(x)
    bare = dtm(out)[0][::-1]
    below = (np.abs(y - MIDDLE) < HALF - 1) & (np.abs(x - MIDDLE) < BED)
    assert (with_deck - true)[below].min() > 4.5
    assert np.abs(bare - true)[below].max() < 0.2
    far = (np.abs(y - MIDDLE) > HALF + 4) | (np.abs(x - MIDDLE) > BED + 12)
    assert np.array_equal(bare[far], with_deck[far])
    assert do(cloud, out, bridges="remove", **settings).did_nothing
    do(cloud, out, **settings)
    assert all_digests(out) == digests
    assert not (out / "bridges.gpkg").exists()


@pytest.mark.slow
def test_tiles_do_not_show_and_points_of_the_deck_are_of_class_17(
    cloud: Path, tmp_path: Path
) -> None:
    """Whatever class they had; what is no part of it keeps its class."""
    las = laspy.read(cloud)
    before = np.random.default_rng(6).choice([1, 2, 5, 6], len(las)).astype(np.uint8)
    las.classification = before
    cloud = tmp_path / "road.laz"
    las.write(cloud)
    results = []
    for tile in ("48", "80"):
        out = tmp_path / tile
        do(cloud, out, bridges="remove", tile_size=tile)
        results.append((all_digests(out), (out / "bridges.gpkg").read_bytes()))
    assert results[0] == results[1]
    las = laspy.read(tmp_path / "48" / "classified" / "road.laz")
    x, y, z = (np.asarray(axis) for axis in (las.x - EAST, las.y - NORTH, las.z))
    bridge = np.asarray(las.classification) == 17
    assert bridge.any()
    off = np.abs(y[bridge] - MIDDLE) - HALF
    assert off.max() < 0.5  # the outline is a little wider than the points of the deck
    assert (off > 0).mean() < 0.01
    middle = (np.abs(x - MIDDLE) < BED) & (np.abs(y - MIDDLE) < HALF - 1) & (z > 49)
    assert bridge[middle].all()
    after = np.asarray(las.classification)[~bridge]
    assert (np.isin(after, (1, 2)) | (after == before[~bridge])).all()
