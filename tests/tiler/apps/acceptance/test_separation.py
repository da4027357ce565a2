"""Differences of swaths are those of the surfaces from which they are sampled."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import rasterio

import tiler
from tests.tiler.apps.acceptance.pulses import Pulses
from tests.tiler.apps.acceptance.test_measuring import ASKED, FEET, found, rows
from tiler.apps.acceptance import Specification, check_clouds
from tiler.apps.acceptance.counts import OFFSET_STEPS, STEPS_PER_METRE, Cells, count_file
from tiler.apps.acceptance.separation import NO_OVERLAP, Separation, separate_swaths
from tiler.errors import ConfigError, ProcessingError
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
    assert (
        "in 296 of 300 shared cells of 2 m, 1 of 1 pair"
        in found_rows["swath_difference"]["remark"]
    )


def test_steep_ground_is_not_compared(tmp_path: Path) -> None:
    steep = rows(two(plane(13), 0.5).write(tmp_path / "a.laz"))
    for name in NAMES:
        assert (steep[name]["found"], steep[name]["state"]) == (None, "not asked")
    remark = steep["swath_difference"]["remark"]
    assert "compared in 0 of 300 shared cells of 2 m, 0 of 1 pair" in remark
    # Cells at corners have too few neighbours.
    assert "296 steeper than 10 degrees, 4 with fewer than 6 of 3 x 3 neighbours" in remark
    assert "not compared: 2 - 1" in remark
    asked = Specification("made", {"pulse_spacing": 0.5, "swath_difference": 1.0})
    assert rows(tmp_path / "a.laz", asked)["swath_difference"]["state"] == "not measured"


def test_plants_are_not_compared(tmp_path: Path) -> None:
    forest = rows(two(plants).write(tmp_path / "a.laz"))["swath_difference"]
    assert forest["found"] is None
    assert "296 rough" in forest["remark"]
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
    # One of the ten columns of cells is above 0.16 m.
    assert found_rows["swath_difference_p95"]["state"] == "fail"


def multiple(las: Any) -> None:
    las.number_of_returns[:] = 2


@pytest.mark.parametrize(
    ("cloud", "change", "state", "reason"),
    [
        (strip(plane(0), 0, 60, 1), None, "pass", NO_OVERLAP),
        (strip(plane(0), 0, 60, 1) + strip(plane(0), 80, 140, 2), None, "pass", NO_OVERLAP),
        (
            strip(plane(0), 0, 60, 0),
            None,
            "not measured",
            "the points have no point source ids",
        ),
        (
            strip(plane(0), 0, 60, 0) + strip(plane(0), 40, 100, 1),
            None,
            "not measured",
            "no overlap of swaths, but 14,400 points without a point source id",
        ),
        (
            two(plane(0)),
            multiple,
            "not measured",
            "no single returns of two swaths in the same cell, although they overlap",
        ),
    ],
)
def test_only_overlaps_that_exist_must_be_measured(
    tmp_path: Path, cloud: Pulses, change: Any, state: str, reason: str
) -> None:
    asked = Specification("made", dict.fromkeys(NAMES, 1.0) | {"pulse_spacing": 0.5})
    path = cloud.write(tmp_path / "a.laz", change=change or (lambda las: None))
    found_rows = rows(path, asked)
    for name in NAMES:
        row = found_rows[name]
        assert (row["found"], row["state"], row["remark"]) == (None, state, reason)


def test_a_wrong_strip_is_not_hidden_by_many_right_ones(tmp_path: Path) -> None:
    steps = [0.0] * 11 + [0.25]
    strips = [strip(plane(0), 40 * i, 40 * i + 60, i + 1, step) for i, step in enumerate(steps)]
    cloud = strips[0]
    for other in strips[1:]:
        cloud += other
    found_rows = rows(cloud.write(tmp_path / "a.laz"))
    for name in ("swath_difference", "swath_difference_p95"):
        assert found_rows[name]["found"] == pytest.approx(0.25, abs=0.02)
        assert found_rows[name]["remark"].startswith("point source 12 - 11")


def test_small_pairs_are_judged_together_and_named(tmp_path: Path) -> None:
    small = strip(plane(0), 96, 110, 3, 0.5).where(lambda x, y: y < 20)
    other = strip(plane(0), 96, 110, 4, -0.5).where(lambda x, y: y > 40)
    summary = check_clouds([(two(plane(0)) + small + other).write(tmp_path / "a.laz")], ASKED)
    found_rows = {row["name"]: row for row in summary["rows"]}
    difference = found_rows["swath_difference"]
    assert difference["found"] == pytest.approx(0.5, abs=0.02)
    assert difference["remark"].startswith(
        "all pairs with fewer than 30 cells (3 - 2, 4 - 2); "
    )
    step = found_rows["swath_step"]
    assert step["found"] < 0.005
    assert (
        "2 pairs with fewer than 30 cells not judged, the largest: point source "
        in step["remark"]
    )
    pairs = {(p["first"], p["second"]): p for p in summary["swath_pairs"]}
    assert set(pairs) == {(1, 2), (2, 3), (2, 4)}
    assert pairs[2, 3]["mean_m"] == pytest.approx(0.5, abs=0.02)
    assert pairs[2, 4]["mean_m"] == pytest.approx(-0.5, abs=0.02)


def test_overlaps_without_a_comparison_are_named(tmp_path: Path) -> None:
    def forest(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.where(x < 70, 100.0, plants(x, y))

    cloud = two(forest) + strip(forest, 80, 140, 3, 1.0) + strip(forest, 120, 180, 4, 2.0)
    summary = check_clouds([cloud.write(tmp_path / "a.laz")], ASKED)
    remark = next(r["remark"] for r in summary["rows"] if r["name"] == "swath_difference")
    assert "compared in 296 of 900 shared cells of 2 m, 1 of 3 pairs" in remark
    assert "not compared: 3 - 2, 4 - 3" in remark
    assert (
        "swaths overlap without a cell that can be compared: 3 - 2, 4 - 3" in summary["notes"]
    )
    assert [(p["first"], p["second"], p["shared_cells"]) for p in summary["swath_pairs"]] == [
        (1, 2, 300),
        (2, 3, 300),
        (3, 4, 300),
    ]
    assert [p["cells"] for p in summary["swath_pairs"]] == [296, 0, 0]


def test_few_cells_with_different_surfaces_are_left_out(tmp_path: Path) -> None:
    """Of a platform of 5 x 5 cells, 3 x 3 are even, because the others have neighbours below it."""

    def platform(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 100 + 2.0 * ((abs(x - 49) < 5) & (abs(y - 21) < 5))

    overlap = strip(plane(0), 0, 60, 1), strip(platform, 40, 100, 2)
    summary = check_clouds([(overlap[0] + overlap[1]).write(tmp_path / "a.laz")], ASKED)
    found_rows = {row["name"]: row for row in summary["rows"]}
    (pair,) = summary["swath_pairs"]
    assert found_rows["swath_difference_largest"]["found"] == pytest.approx(2, abs=0.05)
    # They are 3 % of the overlap, so they count.
    assert pair["different_surfaces"] == 0
    assert found_rows["swath_difference"]["found"] > 0.3
    more = two(plane(0))
    more.y += 60
    summary = check_clouds([(overlap[0] + overlap[1] + more).write(tmp_path / "b.laz")], ASKED)
    found_rows = {row["name"]: row for row in summary["rows"]}
    (pair,) = summary["swath_pairs"]
    assert pair["different_surfaces"] == 9
    assert found_rows["swath_difference"]["found"] < 0.02
    assert (
        "; 9 compared cells with different surfaces left out"
        in found_rows["swath_difference"]["remark"]
    )
    assert found_rows["swath_difference_largest"]["found"] == pytest.approx(2, abs=0.05)


def sums_of(heights: list[np.ndarray], side: float = 2.0) -> tuple[Any, Any, Cells]:
    """Sums of swaths whose heights, shape (rows, columns, points), have their points at the centres of cells."""
    cells = Cells.around(0.0, 0.0, side / 2)
    keys, sums = [], []
    for source, height in enumerate(heights, 1):
        row, column, _ = np.indices(height.shape)
        x, y = ((index.ravel() + 0.5) * side for index in (column, row))
        of_swath = np.full(x.size, source, np.uint16)
        found_keys, found_sums = cells.of_heights.height_sums(x, y, height.ravel(), of_swath)
        keys.append(found_keys)
        sums.append(found_sums)
    return np.concatenate(keys), np.concatenate(sums), cells


def test_all_pairs_are_compared_once() -> None:
    """Each cell has all swaths, so each pair shares all cells."""
    k, side = 12, 6
    heights = [np.full((side, side, 4), 0.01 * 2.0**swath) for swath in range(k)]
    keys, sums, cells = sums_of(heights)
    separation = separate_swaths(keys, sums, cells, 1.0, 1e9)
    assert isinstance(separation, Separation)
    assert len(separation.pairs) == k * (k - 1) // 2
    assert {p["shared_cells"] for p in separation.pairs} == {side**2}
    assert {p["cells"] for p in separation.pairs} == {side**2 - 4}
    for pair in separation.pairs:
        expected = 0.01 * (2.0 ** (pair["second"] - 1) - 2.0 ** (pair["first"] - 1))
        assert pair["mean_m"] == pytest.approx(expected, abs=1e-3)
    # Only the worst pair of a cell is kept.
    assert separation.difference_m.size == side**2 - 4
    assert set(separation.second.tolist()) == {k}
    assert set(separation.first.tolist()) == {1}
    assert "too many cells of swaths" in str(separate_swaths(keys, sums, cells, 1.0, 1e4))


@pytest.mark.parametrize("middle", [0.0, 990.0, 15_990.0, -15_990.0])
@pytest.mark.parametrize("spread_m", [0.02, 9.0])
def test_many_high_points_do_not_overflow(middle: float, spread_m: float) -> None:
    """A cell has 90,000 heights, whose squares have a sum beyond 2**63."""
    height = np.full((3, 3, 90_000), middle)
    height[..., ::2] += spread_m
    height[..., 1::2] -= spread_m
    keys, sums, cells = sums_of([height, height + 1])
    separation = separate_swaths(keys, sums, cells, 1.0, 1e9)
    assert isinstance(separation, Separation)
    (pair,) = separation.pairs
    assert pair["cells"] == (5 if spread_m < 1 else 0)
    if pair["cells"]:
        assert pair["mean_m"] == pytest.approx(1.0, abs=1e-6)


def test_heights_beyond_the_range_are_named(tmp_path: Path) -> None:
    def change(las: Any) -> None:
        las.z[:7] = 17_000

    summary = check_clouds([two(plane(0)).write(tmp_path / "a.laz", change=change)], ASKED)
    assert any(
        note.startswith("7 single returns with heights beyond 16,000 m")
        for note in summary["notes"]
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
        *cells.of_heights.height_sums(x, y, z, source), cells, 1.0, 1e9
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
        # The differences refer to no vertical datum.
        assert raster.crs.to_epsg() == 25832
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


def test_the_style_has_the_limits_and_only_a_users_one_is_kept(tmp_path: Path) -> None:
    path = two(plane(0)).write(tmp_path / "a.laz")
    asked = Specification("made", {"pulse_spacing": 0.5, "swath_difference": 0.04})
    style = tmp_path / "swaths.qml"
    for specification, ends in (
        (None, ["0.08", "0.16", "inf"]),
        (asked, ["0.04", "0.08", "inf"]),
    ):
        summary = check_clouds([path], specification, tmp_path / "swaths.tif")
        assert (summary["style"], summary["notes"]) == (str(style), [])
        items = list(ElementTree.fromstring(style.read_text()).iter("item"))
        assert [item.get("value") for item in items] == ends
    style.write_text("mine")
    summary = check_clouds([path], None, tmp_path / "swaths.tif")
    assert style.read_text() == "mine"
    assert summary["style"] is None
    assert summary["notes"] == [f"{style}: was kept, because it is not a style of this command"]


def test_a_raster_of_nothing_is_not_written(tmp_path: Path) -> None:
    path = strip(plane(0), 0, 60, 1).write(tmp_path / "a.laz")
    target = tmp_path / "swaths.tif"
    summary = check_clouds([path], ASKED, target)
    assert summary["difference"] is None
    assert summary["notes"] == [f"{target}: was not written: {NO_OVERLAP}"]
    assert not target.exists()
    target.write_text("older")
    result = tiler.check_clouds(path, difference=target)
    assert result.exit_code == ProcessingError.exit_code
    older = f"{target}: was not written: {NO_OVERLAP}; the file that is there is older"
    assert result.summary["notes"] == [older]
    assert target.read_text() == "older"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("swaths.png", "its suffix does not match"),
        ("none/swaths.tif", "its folder does not exist"),
        ("folder.tif", "is a folder"),
        ("https://example.org/swaths.tif", "is a URL"),
    ],
)
def test_the_target_is_checked_before_points_are_read(
    tmp_path: Path, name: str, message: str
) -> None:
    (tmp_path / "folder.tif").mkdir()
    target = Path(name) if ":" in name else tmp_path / name
    path = tmp_path / "a.laz"
    path.write_bytes(b"no cloud")
    with pytest.raises(ConfigError, match=message):
        check_clouds([path], ASKED, target)
