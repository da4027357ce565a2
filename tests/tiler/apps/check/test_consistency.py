"""Steps that were built into a surface are found, and no others; so are differences of strips."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import laspy
import numpy as np
import pytest

from tests.tiler.apps.check.rasters import tilted, write_heights, write_surface
from tiler.apps.check import TileEdges, seam_steps, strip_differences
from tiler.apps.check.consistency import seams_of
from tiler.errors import ConfigError, InputError
from tiler.io.las import reader
from tiler.report.accuracy import seams_text


def stepped(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The plane, 0.1 higher in every second tile of 10 along x, 0.25 higher north of y = 20."""
    return tilted(x, y) + 0.1 * (np.floor(x / 10) % 2) + 0.25 * (y > 20)


def test_a_plane_has_steps_and_no_jumps(tmp_path: Path) -> None:
    facts = seam_steps(write_surface(tmp_path / "d.tif", tilted), TileEdges(10))
    # Three edges in each direction, 40 pixels long; 39 x 40 pairs in each direction.
    assert facts["tiles"]["pairs"] == 6 * 40
    assert facts["interior"]["pairs"] == 2 * 39 * 40 - 6 * 40
    for name in ("tiles", "interior"):
        assert facts[name]["mean_step"] == pytest.approx(0.25, abs=1e-4)  # half 0.3, half 0.2
        assert facts[name]["largest_step"] == pytest.approx(0.3, abs=1e-4)
        assert facts[name]["largest_jump"] == pytest.approx(0.0, abs=1e-4)
    assert facts["excess"] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("block", [1024, 16])
def test_steps_at_the_edges_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, block: int
) -> None:
    monkeypatch.setattr("tiler.apps.evaluate.rasters.BLOCK", block)
    facts = seam_steps(write_surface(tmp_path / "d.tif", stepped), TileEdges(10))
    # Of six edges three are jumps of 0.1, one is a jump of 0.25, two are none.
    assert facts["tiles"]["mean_jump"] == pytest.approx((3 * 0.1 + 0.25) / 6, abs=1e-4)
    assert facts["tiles"]["largest_jump"] == pytest.approx(0.25, abs=1e-4)
    # The pair beside a jump sees half of it in one neighbour's slope.
    assert facts["interior"]["largest_jump"] == pytest.approx(0.125, abs=1e-4)
    assert facts["excess"] > 0.05


def test_edges_of_the_wrong_lattice_show_nothing(tmp_path: Path) -> None:
    path = write_surface(tmp_path / "d.tif", stepped)
    assert (
        seam_steps(path, TileEdges(10 / 3 * 2))["excess"]
        < seam_steps(path, TileEdges(10))["excess"] / 2
    )


def test_chance_at_few_pairs_is_no_seam(tmp_path: Path) -> None:
    """White noise on an edge of 12 pixels: 60 rasters without a seam, and the same ones with a step of 0.3."""
    told = {0.0: 0, 0.3: 0}
    for seed in range(60):
        noise = np.random.default_rng(seed).normal(0, 0.02, (12, 24))
        for step in told:
            heights = noise + step * (np.arange(24) >= 12)
            path = write_heights(tmp_path / "d.tif", heights, west=-12, north=12.5)
            facts = seam_steps(path, TileEdges(100))
            told[step] += seams_text(facts).startswith("Seams")
            assert facts["tiles"]["pairs"] == 12
            assert 0 < facts["excess_error"] < 0.05
    assert told == {0.0: 0, 0.3: 60}


def test_rough_places_are_not_seams(tmp_path: Path) -> None:
    """An edge through a rough strip is compared with the lines beside it, not with the smooth rest."""
    noise = np.random.default_rng(4).normal(0, 1, (240, 240))

    def rough(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.where(np.abs(x - 120) < 20, noise, 0 * y)

    facts = seam_steps(write_surface(tmp_path / "d.tif", rough, side=240), TileEdges(120))
    # 18 lines on each side of two edges
    assert facts["beside_tiles"]["pairs"] == 2 * 2 * 18 * 240
    assert facts["tiles"]["mean_jump"] > facts["interior"]["mean_jump"] + 0.2
    assert abs(facts["excess"]) < 0.1


@pytest.mark.parametrize("west", [0.0, 3.0, -7.0])
def test_edges_are_anchored_at_zero(tmp_path: Path, west: float) -> None:
    path = write_surface(
        tmp_path / "d.tif", lambda x, y: 0 * y + (np.floor(x / 10) % 2), west=west
    )
    facts = seam_steps(path, TileEdges(10))
    assert facts["tiles"]["largest_step"] == 1
    assert facts["interior"]["largest_step"] == 0


def test_tiles_of_buckets_end_where_their_buckets_do() -> None:
    # Buckets of 4 have centres at 2, 6, 10, ...; the one from 8 to 12 belongs to the tile that
    # begins at 10.
    assert TileEdges(10, 4).between(0, 40) == [8, 20, 28]
    assert TileEdges(10).between(0, 40) == [10, 20, 30]
    assert TileEdges(10).between(-15, 10) == [-10, 0]


def test_holes_are_not_steps(tmp_path: Path) -> None:
    facts = seam_steps(
        write_surface(tmp_path / "d.tif", tilted, holes=((5, 10), (6, 20))), TileEdges(10)
    )
    assert facts["tiles"]["largest_step"] < 0.31
    assert facts["tiles"]["pairs"] == 6 * 40 - 2


def test_tiles_are_those_of_the_run(tmp_path: Path) -> None:
    path = write_surface(tmp_path / "dtm.tif", stepped, crs="EPSG:2992", unit="foot")
    assert seams_of(path, None) is None
    plan = {
        "units": {"horizontal": "foot", "vertical": "foot"},
        "tile_m": 3.048,
        "bucket_m": 0.3048,
    }
    (tmp_path / "run.json").write_text(json.dumps({"plan": plan}))
    found = seams_of(path, None)
    assert found is not None
    assert (found["unit"], found["tile"], found["bucket"]) == ("foot", 10, 1)
    assert found["tiles"]["largest_jump"] == pytest.approx(0.25, abs=1e-4)
    assert found["blocks"]["pairs"] == 0  # the raster is one block
    asked = seams_of(path, Fraction(3048, 1000))
    assert asked is not None
    assert asked["tiles"] == found["tiles"]
    (tmp_path / "run.json").write_text("{}")
    with pytest.raises(InputError, match="give --tile-size"):
        seams_of(path, None)


def test_unfit_rasters_are_refused(tmp_path: Path) -> None:
    path = write_surface(tmp_path / "d.tif", tilted)
    for tile, message in ((0, "must be above 0"), (3, "must be four pixels at least")):
        with pytest.raises(ConfigError, match=message):
            seams_of(path, Fraction(tile))
    with pytest.raises(InputError, match="cannot be read"):
        seam_steps(tmp_path / "absent.tif", TileEdges(10))
    with pytest.raises(InputError, match="cannot be read"):
        seams_of(tmp_path / "absent.tif", None)


def write_strips(
    path: Path, offsets: dict[int, float], classes: int = 2, steep: float = 0.0
) -> Path:
    """Strips 30 m wide, 20 m apart, 20 m long, of 4 points/m2 over a gentle plane, each with an offset."""
    rng = np.random.default_rng(9)
    parts = []
    for number, (strip, offset) in enumerate(offsets.items()):
        x, y = rng.uniform(0, 30, 2400) + 20 * number, rng.uniform(0, 20, 2400)
        z = tilted(x, y) * 0.1 + offset + steep * x
        parts.append(np.stack((x, y, z, np.full(2400, strip))))
    x, y, z, strip = np.concatenate(parts, axis=1)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, 0.001)
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = x, y, z
    cloud.point_source_id = strip.astype(np.uint16)
    cloud.classification = np.full(x.size, classes, np.uint8)
    cloud.write(path)
    return path


@pytest.mark.parametrize("bytes_at_once", [1 << 27, 20_000])
def test_offsets_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bytes_at_once: int
) -> None:
    monkeypatch.setattr(reader, "BYTES_PER_BATCH", bytes_at_once)
    facts = strip_differences(
        [write_strips(tmp_path / "a.laz", {11: 0.0, 12: 0.05, 14: -0.02})]
    )
    assert facts["strips"] == {"11": 2400, "12": 2400, "14": 2400}
    assert [(p["first"], p["second"]) for p in facts["pairs"]] == [(11, 12), (12, 14)]
    first, second = facts["pairs"]
    assert first["median"] == pytest.approx(0.05, abs=0.01)
    assert second["median"] == pytest.approx(-0.07, abs=0.01)
    assert 40 <= first["cells"] <= 50  # 10 m x 20 m in cells of 2 m
    assert facts["cells"] == first["cells"] + second["cells"]
    assert facts["all"]["rmse"] == pytest.approx(np.hypot(0.05, 0.07) / np.sqrt(2), abs=0.01)


def test_files_share_strips(tmp_path: Path) -> None:
    one, other = (write_strips(tmp_path / f"{k}.laz", {k: z}) for k, z in ((7, 0.0), (8, 0.1)))
    facts = strip_differences([one, other])
    assert [(p["first"], p["second"]) for p in facts["pairs"]] == [(7, 8)]
    assert facts["all"]["median"] == pytest.approx(0.1, abs=0.01)


def test_steep_cells_are_left_out(tmp_path: Path) -> None:
    facts = strip_differences([write_strips(tmp_path / "a.laz", {1: 0.0, 2: 0.05}, steep=0.5)])
    assert facts["cells"] == 0
    assert facts["rough"] >= 40
    assert facts["all"]["rmse"] is None


def test_a_single_strip_has_no_differences(tmp_path: Path) -> None:
    facts = strip_differences([write_strips(tmp_path / "a.laz", {0: 0.0})])
    assert (facts["strips"], facts["pairs"], facts["cells"]) == ({"0": 2400}, [], 0)


def test_without_ground_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no ground"):
        strip_differences([write_strips(tmp_path / "a.laz", {1: 0.0}, classes=1)])
