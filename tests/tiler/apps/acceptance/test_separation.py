"""Differences of swaths are those of the surfaces from which they are sampled."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import rasterio

from tests.tiler.apps.acceptance.pulses import Pulses
from tests.tiler.apps.acceptance.test_measuring import ASKED, FEET, found, rows
from tiler.apps.acceptance import Specification, check_clouds
from tiler.apps.acceptance.counts import OFFSET_STEPS, STEPS_PER_METRE, Cells, count_file
from tiler.apps.acceptance.separation import Separation, separate_swaths
from tiler.errors import ConfigError
from tiler.io.las.reader import PointReader

Surface = Callable[[np.ndarray, np.ndarray], np.ndarray]
NAMES = ("swath_difference", "swath_difference_p95", "swath_difference_largest", "swath_step")
NOISE_M = 0.02


def strip(
    surface: Surface, x0: float, x1: float, source: int, step: float = 0.0, seed: int = 0
) -> Pulses:
    """Pulses at random places, four per square metre, on a surface with the noise of a scanner."""
    random = np.random.default_rng(10 * source + seed)
    n = int((x1 - x0) * 60 * 4)
    pulses = Pulses(random.uniform(x0, x1, n), random.uniform(0, 60, n), source)
    heights = surface(pulses.x, pulses.y) + random.normal(0, NOISE_M, n)
    pulses.z = np.round(heights + step, 3)
    return pulses


def plane(degrees: float) -> Surface:
    rise = np.tan(np.radians(degrees))
    return lambda x, y: 100 + rise * (0.8 * x + 0.6 * y)


def two(surface: Surface, step: float = 0.0) -> Pulses:
    return strip(surface, 0, 60, 1) + strip(surface, 40, 100, 2, step)


def plants(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 100 + np.random.default_rng(x.size).uniform(0, 12, x.size)


@pytest.mark.parametrize("degrees", [0, 4, 8])
@pytest.mark.parametrize("step", [0.0, 0.05, -0.12])
def test_a_step_of_two_strips_is_found_on_any_slope(
    tmp_path: Path, degrees: float, step: float
) -> None:
    asked = Specification("made", {"pulse_spacing": 0.5, "swath_step": 0.03})
    path = two(plane(degrees), step).write(tmp_path / "a.laz")
    steps = rows(path, asked)["swath_step"]
    assert steps["found"] == pytest.approx(abs(step), abs=0.003)
    assert steps["state"] == ("fail" if step else "pass")
    pair, mean = steps["where"][0].split(": ")[0], steps["where"][0].split(": ")[1]
    assert pair == "point source 2 - 1"
    assert float(mean.split(" m")[0]) == pytest.approx(step, abs=0.003)
    x, y = map(float, steps["where"][0].split("around ")[1].split())
    assert (x, y) == pytest.approx((500_050, 5_000_030), abs=2)


def test_figures_are_those_of_the_noise(tmp_path: Path) -> None:
    """A cell of 2 m has 16 points of each strip, so a difference has the noise of a point times sqrt(2 / 16)."""
    found_rows = rows(two(plane(6)).write(tmp_path / "a.laz"))
    deviation = NOISE_M * (2 / 16) ** 0.5
    assert found_rows["swath_difference"]["found"] == pytest.approx(deviation, rel=0.2)
    assert found_rows["swath_difference_p95"]["found"] == pytest.approx(
        1.96 * deviation, rel=0.2
    )
    assert "in cells of 2 m" in found_rows["swath_difference"]["remark"]


def test_steep_ground_is_not_compared(tmp_path: Path) -> None:
    steep = rows(two(plane(13), 0.5).write(tmp_path / "a.laz"))
    for name in NAMES:
        assert steep[name]["found"] is None
        assert "no open, even ground" in steep[name]["remark"]


def test_plants_are_not_compared(tmp_path: Path) -> None:
    forest = rows(two(plants).write(tmp_path / "a.laz"))["swath_difference"]
    assert forest["found"] is None
    assert "no open, even ground" in forest["remark"]
    meadow = two(lambda x, y: np.where(y < 30, plants(x, y), 100.0), 0.05)
    found_rows = found(meadow.write(tmp_path / "b.laz"))
    assert found_rows["swath_step"] == pytest.approx(0.05, abs=0.003)
    assert found_rows["swath_difference_largest"] < 0.1


def test_walls_and_parked_cars_do_not_show(tmp_path: Path) -> None:
    def house(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.where((abs(x - 50) < 6) & (abs(y - 20) < 8), 108.0, 100.0)

    def house_and_car(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return house(x, y) + 1.5 * ((abs(x - 51) < 1) & (abs(y - 45) < 2.2))

    cloud = strip(house, 0, 60, 1) + strip(house_and_car, 40, 100, 2)
    assert found(cloud.write(tmp_path / "a.laz"))["swath_difference_largest"] < 0.05


def test_the_worst_pair_is_named_first(tmp_path: Path) -> None:
    flat = plane(0)
    cloud = strip(flat, 0, 60, 7) + strip(flat, 40, 100, 8, 0.02) + strip(flat, 80, 140, 9, 0.1)
    steps = rows(cloud.write(tmp_path / "a.laz"))["swath_step"]
    assert [where.split(":")[0] for where in steps["where"]] == [
        "point source 9 - 8",
        "point source 8 - 7",
    ]
    assert steps["found"] == pytest.approx(0.08, abs=0.003)


def test_places_of_the_largest_differences_are_cells_of_the_error(tmp_path: Path) -> None:
    def bent(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 100 + np.maximum(x - 55, 0) * 0.06

    cloud = strip(plane(0), 0, 60, 1) + strip(bent, 40, 100, 2)
    asked = Specification("made", {"pulse_spacing": 0.5, "swath_difference_p95": 0.16})
    found_rows = rows(cloud.write(tmp_path / "a.laz"), asked)
    largest = found_rows["swath_difference_largest"]
    assert largest["found"] == pytest.approx(4 * 0.06, abs=0.03)
    assert all(float(where.split()[0]) == 500_059 for where in largest["where"])
    # The differences beyond are those of one of the ten columns of 30 cells. Cells at corners have too few neighbours.
    assert (
        found_rows["swath_difference_p95"]["remark"]
        == f"{100 * 28 / 296:.2g} % are beyond 0.16 m"
    )
    assert found_rows["swath_difference_p95"]["state"] == "fail"


@pytest.mark.parametrize(
    ("cloud", "reason"),
    [
        (strip(plane(0), 0, 60, 1), "the points have fewer than two swaths"),
        (strip(plane(0), 0, 60, 0), "the points have no point source ids"),
        (
            strip(plane(0), 0, 60, 1) + strip(plane(0), 80, 140, 2),
            "no two swaths have 3 single returns each in the same cell",
        ),
    ],
)
def test_without_overlap_nothing_is_measured(
    tmp_path: Path, cloud: Pulses, reason: str
) -> None:
    asked = Specification("made", dict.fromkeys(NAMES, 1.0) | {"pulse_spacing": 0.5})
    found_rows = rows(cloud.write(tmp_path / "a.laz"), asked)
    for name in NAMES:
        assert (found_rows[name]["state"], found_rows[name]["remark"]) == (
            "not measured",
            reason,
        )


def test_different_vertical_crs_are_not_compared(tmp_path: Path) -> None:
    paths = [
        strip(plane(0), 0, 60, 1).write(tmp_path / "a.laz", "EPSG:25832+5783"),
        strip(plane(0), 40, 100, 2).write(tmp_path / "b.laz", "EPSG:25832+7837"),
    ]
    assert rows(paths)["swath_step"]["remark"] == "the files have different vertical CRSs"


def test_points_that_are_left_out_do_not_show(tmp_path: Path) -> None:
    def change(las: Any) -> None:
        nth = np.arange(len(las.x)) % 8
        las.z[nth < 4] += 1.0
        las.number_of_returns[nth == 0] = 2
        las.withheld[nth == 1] = 1
        las.classification[nth == 2] = 18
        las.classification[nth == 3] = 9
        las.overlap[:] = 1

    path = two(plane(3), 0.05).write(tmp_path / "a.laz", change=change)
    found_rows = found(path)
    assert found_rows["swath_step"] == pytest.approx(0.05, abs=0.005)
    assert found_rows["swath_difference_largest"] < 0.1


def test_cuts_formats_and_order_do_not_change_a_bit(tmp_path: Path) -> None:
    cloud = two(lambda x, y: plane(5)(x, y) + 0.3 * np.sin(x / 5), 0.05)
    expected = rows(cloud.write(tmp_path / "a.laz"))
    shuffled = cloud.take(np.random.default_rng(1).permutation(cloud.x.size))
    parts = [
        shuffled.where(lambda x, y: x + 0.3 * y > 57).write(tmp_path / "b.las"),
        shuffled.where(lambda x, y: x + 0.3 * y <= 57).write(
            tmp_path / "c.laz", point_format=1
        ),
    ]
    for name in NAMES:
        assert rows(parts)[name] == expected[name]
        assert rows(parts[::-1])[name] == expected[name]


def test_pieces_do_not_change_the_sums(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = two(plane(5), 0.05).write(tmp_path / "a.laz")
    cells = Cells.around(500_050, 5_000_030, 1.0)
    whole = count_file(path, cells, None)
    pieces = PointReader.pieces
    monkeypatch.setattr(PointReader, "pieces", lambda reader: pieces(reader, 1000))
    cut = count_file(path, cells, None)
    np.testing.assert_array_equal(cut.height_keys, whole.height_keys)
    np.testing.assert_array_equal(cut.height_sums, whole.height_sums)
    assert whole.height_sums[:, 0].sum() == 2 * 60 * 60 * 4


def test_feet_give_the_figures_of_metres(tmp_path: Path) -> None:
    cloud = two(plane(5), 0.05)
    metres = found(cloud.write(tmp_path / "a.laz"))
    cloud.z = np.round(cloud.z / FEET, 3)
    feet = found(cloud.write(tmp_path / "b.laz", crs="EPSG:2994", metres=FEET))
    for name in ("swath_difference", "swath_difference_p95", "swath_step"):
        assert feet[name] == pytest.approx(metres[name], abs=0.002)


def test_differences_are_those_of_planes_of_least_squares() -> None:
    """Each swath has a plane through the centres of gravity of 3 x 3 cells, moved to that of the middle cell."""
    random = np.random.default_rng(3)
    n, side = 6000, 2.0
    x, y = random.uniform(0, 40, (2, 2 * n))
    z = 100 + 0.1 * x + 0.02 * np.sin(x * y / 50) + random.normal(0, 0.02, 2 * n)
    source = np.repeat([4, 9], n).astype(np.uint16)
    cells = Cells.around(20.0, 20.0, side / 2)
    separation = separate_swaths(
        *cells.of_heights.height_sums(x, y, z, source), cells, 1.0, None
    )
    assert isinstance(separation, Separation)
    assert separation.difference_m.size > 300
    for i in range(0, separation.difference_m.size, 17):
        heights = []
        for swath in (4, 9):
            means = []
            for dx, dy in ((c, r) for r in (0, -1, 1) for c in (0, -1, 1)):
                at = (separation.x[i] + side * dx, separation.y[i] + side * dy)
                mine = (abs(x - at[0]) < side / 2) & (abs(y - at[1]) < side / 2)
                mine &= source == swath
                if mine.sum() >= 3:
                    means.append((x[mine].mean(), y[mine].mean(), z[mine].mean(), 1.0))
            x_mean, y_mean, z_mean, one = np.array(means).T
            a, b, _ = np.linalg.lstsq(np.stack((x_mean, y_mean, one), 1), z_mean)[0]
            heights.append(
                z_mean[0]
                - a * (x_mean[0] - separation.x[i])
                - b * (y_mean[0] - separation.y[i])
            )
        expected = heights[1] - heights[0]
        rounding = 1 / STEPS_PER_METRE + 0.2 * side / OFFSET_STEPS
        assert separation.difference_m[i] == pytest.approx(expected, abs=rounding)


def test_the_raster_has_the_differences_of_the_cells(tmp_path: Path) -> None:
    x0, y0 = 500_000, 5_000_000
    path = two(lambda x, y: np.where(y < 30, 100.0, plants(x, y)), 0.1).write(
        tmp_path / "a.laz"
    )
    target = tmp_path / "swaths.tif"
    summary = check_clouds([path], ASKED, target)
    assert summary["difference"] == str(target)
    with rasterio.open(target) as raster:
        assert raster.crs.to_epsg() == 25832 or "25832" in raster.crs.to_wkt()
        assert (raster.units[0], raster.nodata, raster.res) == ("metre", -9999, (2, 2))
        values = raster.read(1)
        # Open ground of both strips, without the cells next to plants.
        assert tuple(raster.bounds) == (x0 + 40, y0, x0 + 60, y0 + 28)
    known = values[values != -9999]
    assert known.size >= 0.95 * values.size
    assert known == pytest.approx(0.1, abs=0.05)
    largest = next(r for r in summary["rows"] if r["name"] == "swath_difference_largest")
    assert float(known.max()) == pytest.approx(largest["found"])
    x, y = map(float, largest["where"][0].split()[:2])
    with rasterio.open(target) as raster:
        assert next(raster.sample([(x, y)]))[0] == known.max()


def test_the_style_has_the_limits_and_is_kept(tmp_path: Path) -> None:
    path = two(plane(0)).write(tmp_path / "a.laz")
    asked = Specification("made", {"pulse_spacing": 0.5, "swath_difference": 0.04})
    style = tmp_path / "swaths.qml"
    check_clouds([path], asked, tmp_path / "swaths.tif")
    items = list(ElementTree.fromstring(style.read_text()).iter("item"))
    assert [item.get("value") for item in items] == ["0.04", "0.08", "inf"]
    style.write_text("mine")
    check_clouds([path], None, tmp_path / "swaths.tif")
    assert style.read_text() == "mine"


def test_a_raster_of_nothing_is_not_written(tmp_path: Path) -> None:
    path = strip(plane(0), 0, 60, 1).write(tmp_path / "a.laz")
    target = tmp_path / "swaths.tif"
    summary = check_clouds([path], ASKED, target)
    assert summary["difference"] is None
    assert summary["notes"] == [
        f"{target}: was not written: the points have fewer than two swaths"
    ]
    assert not target.exists()
    with pytest.raises(ConfigError, match=r"its suffix does not match"):
        check_clouds([path], ASKED, tmp_path / "swaths.png")
