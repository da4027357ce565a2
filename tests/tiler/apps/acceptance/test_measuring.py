"""Rows of the check of clouds are those of formulas, and do not depend on files, cuts and order."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from tests.tiler.apps.acceptance.pulses import ALL, Pulses, lattice
from tiler.apps.acceptance import Specification, check_clouds, read_specification
from tiler.apps.acceptance.counts import count_file
from tiler.apps.acceptance.measuring import _remedies_of_check
from tiler.errors import ConfigError, InputError
from tiler.schedule.guard import ChildMemoryError

ASKED = Specification("made", {"pulse_spacing": 0.5, "pulse_density": 4})
FEET = 0.3048


def found(paths: Sequence[Path] | Path, spec: Specification | None = ASKED) -> dict[str, Any]:
    return {name: row["found"] for name, row in rows(paths, spec).items()}


def rows(paths: Sequence[Path] | Path, spec: Specification | None = ASKED) -> dict[str, Any]:
    given = [paths] if isinstance(paths, Path) else list(paths)
    return {row["name"]: row for row in check_clouds(given, spec)["rows"]}


def square(side: float = 60.0, source: int = 1) -> Pulses:
    return Pulses(*lattice(0, side, 0, side), source)


def test_density_and_spacing_are_those_of_the_lattice(tmp_path: Path) -> None:
    found_rows = found(square().write(tmp_path / "a.laz"))
    assert found_rows["pulse_density"] == pytest.approx(4)
    assert found_rows["pulse_spacing"] == pytest.approx(0.5)
    assert found_rows["swath_density_least"] == pytest.approx(4)
    assert found_rows["dense_cells"] == 100
    assert found_rows["distribution"] == 100
    assert found_rows["voids"] == 0


def test_later_returns_and_withheld_points_are_no_pulses(tmp_path: Path) -> None:
    def change(las: Any) -> None:
        # Of the four pulses of a cell, only one is a first return that is not withheld.
        column, row = np.arange(120 * 120) % 120, np.arange(120 * 120) // 120
        las.number_of_returns[:] = 2
        las.return_number[row % 2 > 0] = 2
        las.withheld = (row % 2 == 0) & (column % 2 > 0)

    counted = found(square().write(tmp_path / "a.laz", change=change))
    assert counted["pulse_density"] == pytest.approx(1)
    assert counted["withheld_points"] == 120 * 120 // 4


def test_a_hole_is_a_void_of_its_area(tmp_path: Path) -> None:
    hole = square().where(lambda x, y: ~((x > 20) & (x < 32) & (y > 30) & (y < 37)))
    found_rows = rows(hole.write(tmp_path / "a.laz"))
    assert found_rows["voids"]["found"] == 1
    assert found_rows["void_area"]["found"] == pytest.approx(12 * 7)
    assert found_rows["voids"]["where"] == ["500026.0 5000033.5 (84 m2)"]
    # It is too narrow to be left out as if it were water. The density is that of the cells wholly inside.
    assert found_rows["pulse_density"]["found"] == pytest.approx(4 * (1 - 84 / 58**2))
    assert found_rows["distribution"]["found"] == pytest.approx(100 * (1 - 84 / 60**2), abs=0.2)


QL1 = read_specification("usgs-ql1")


@pytest.mark.parametrize("apart", [2.5, 5.0, 10.0])
def test_scan_lines_far_apart_are_not_dense(tmp_path: Path, apart: float) -> None:
    """Their gaps are no water: 10 pulses a metre along lines some metres apart."""
    x, y = np.meshgrid(np.arange(0, 120, 0.1) + 0.05, np.arange(0, 120, apart) + 0.05)
    found_rows = found(Pulses(x.ravel(), y.ravel()).write(tmp_path / "a.laz"), QL1)
    assert found_rows["pulse_density"] == pytest.approx(10 / apart, rel=0.2)
    assert found_rows["distribution"] < 60


@pytest.mark.parametrize("per_m2", [1.0, 2.0, 8.0])
def test_random_pulses_have_the_distribution_of_chance(tmp_path: Path, per_m2: float) -> None:
    """A cell of half a square metre is empty with the chance exp(-per_m2 / 2)."""
    x, y = np.random.default_rng(1).uniform(0, 150, (2, int(per_m2 * 150**2)))
    found_rows = found(Pulses(x, y).write(tmp_path / "a.laz"), QL1)
    assert found_rows["distribution"] == pytest.approx(100 * (1 - math.exp(-per_m2 / 2)), abs=2)
    assert found_rows["pulse_density"] == pytest.approx(per_m2, rel=0.03)


def random_pulses(
    rng: np.random.Generator, width: float, height: float, per_m2: float, source: int = 1
) -> Pulses:
    number = rng.poisson(per_m2 * width * height)
    return Pulses(*rng.uniform((0, 0), (width, height), (number, 2)).T, source)


@pytest.mark.parametrize(
    ("width", "height", "per_m2", "degrees"),
    [
        (60, 60, 4, 0),
        (60, 90, 1, 0),
        (61.3, 60.7, 8, 0),
        (400, 150, 4, 0),
        (400, 400, 1, 0),
        (100, 60, 4, 30),
        (250, 200, 2, 17),
    ],
)
def test_density_is_that_of_random_pulses_whatever_the_extent(
    tmp_path: Path, width: float, height: float, per_m2: float, degrees: float
) -> None:
    """The errors are those of chance, and so is their mean. Four empty cells are a void once in 100 such surveys."""
    angle = math.radians(degrees)
    n, errors = per_m2 * width * height, []
    for seed in range(4):
        pulses = random_pulses(np.random.default_rng(seed), width, height, per_m2)
        x, y = pulses.x + 0.37 * seed, pulses.y + 0.21 * seed
        pulses.x = x * math.cos(angle) - y * math.sin(angle)
        pulses.y = x * math.sin(angle) + y * math.cos(angle)
        spec = Specification("made", {"pulse_density": per_m2}) if seed % 2 else None
        found_rows = found(pulses.write(tmp_path / "a.laz"), spec)
        errors.append(found_rows["pulse_density"] / per_m2 - 1)
        assert found_rows["pulse_spacing"] == pytest.approx(found_rows["pulse_density"] ** -0.5)
        assert found_rows["swath_density_least"] == pytest.approx(found_rows["pulse_density"])
        assert found_rows["voids"] <= 1
    assert max(map(abs, errors)) < 3 / math.sqrt(n)
    assert abs(np.mean(errors)) < 2.5 / math.sqrt(4 * n)


@pytest.mark.parametrize("per_m2", [0.5, 4.0])
def test_a_lake_does_not_change_the_density_of_random_pulses(
    tmp_path: Path, per_m2: float
) -> None:
    """The cells are those of 4 pulses per square metre, so that many are empty around the lake of the sparse cloud."""
    errors = []
    for seed in range(3):
        pulses = random_pulses(np.random.default_rng(seed), 160, 160, per_m2)
        shore = pulses.where(lambda x, y: np.hypot(x - 81, y - 79) > 35)
        errors.append(found(shore.write(tmp_path / "a.laz"))["pulse_density"] / per_m2 - 1)
    assert abs(np.mean(errors)) < 3 / math.sqrt(3 * shore.x.size)


def test_missing_strips_lower_the_density(tmp_path: Path) -> None:
    corridor = random_pulses(np.random.default_rng(3), 400, 24, 4)
    half = corridor.where(lambda x, y: x % 16 < 8)
    spec = Specification("made", {"pulse_density": 4.0})
    found_rows = found(half.write(tmp_path / "a.laz"), spec)
    # Without the gaps it would be 4. At the corners of the gaps the outline is too narrow.
    assert 2 <= found_rows["pulse_density"] < 2.5


def test_a_swath_without_a_whole_cell_has_an_overlap_and_no_density(tmp_path: Path) -> None:
    """A ring one cell wide around another swath, whose footprint is the whole square."""
    rng = np.random.default_rng(4)
    ring = random_pulses(rng, 100, 100, 4, 2).where(
        lambda x, y: np.maximum(abs(x - 50), abs(y - 50)) > 49
    )
    both = random_pulses(rng, 100, 100, 4) + ring
    found_rows = rows(both.write(tmp_path / "a.laz"))
    assert 0 < found_rows["swath_overlap"]["found"] <= 100
    assert found_rows["swath_density_least"]["found"] == pytest.approx(4, rel=0.05)


def test_ids_of_many_pulses_in_a_cell_may_be_random(tmp_path: Path) -> None:
    pulses = random_pulses(np.random.default_rng(6), 100, 100, 8)
    pulses.source = np.random.default_rng(7).integers(1, 200, pulses.x.size)
    found_rows = rows(pulses.write(tmp_path / "a.laz"))
    assert found_rows["swath_overlap"]["remark"] == "the point source ids look random"


@pytest.mark.parametrize("degrees", [0, 25])
def test_overlap_is_that_of_random_pulses_whatever_the_cells(
    tmp_path: Path, degrees: float
) -> None:
    angle, errors = math.radians(degrees), []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        second = random_pulses(rng, 60.0, 80.0, 4, 2)
        second.x += 40
        swaths = random_pulses(rng, 60.0, 80.0, 4) + second
        x, y = swaths.x + 0.3 * seed, swaths.y + 0.2 * seed
        swaths.x = x * math.cos(angle) - y * math.sin(angle)
        swaths.y = x * math.sin(angle) + y * math.cos(angle)
        errors.append(found(swaths.write(tmp_path / "a.laz"))["swath_overlap"] - 20)
    # The standard deviation of 40 such surveys is 0.08.
    assert max(map(abs, errors)) < 0.3
    assert abs(np.mean(errors)) < 0.15


def test_missing_lines_are_gaps(tmp_path: Path) -> None:
    swaths = Pulses(*lattice(0, 60, 0, 80), 1) + Pulses(*lattice(200, 260, 0, 80), 2)
    found_rows = rows(swaths.write(tmp_path / "a.laz"))
    assert found_rows["swath_gaps"]["found"] == 1
    assert "2 separate parts" in found_rows["swath_gaps"]["remark"]


def test_much_water_is_not_left_out(tmp_path: Path) -> None:
    lake = square(100).where(lambda x, y: (abs(x - 50) > 40) | (abs(y - 50) > 40))
    found_rows = found(lake.write(tmp_path / "a.laz"))
    assert found_rows["distribution"] == pytest.approx(36, abs=1)


@pytest.mark.parametrize(("side", "voids"), [(1, 0), (2, 1)])
def test_a_void_has_the_area_of_four_spacings_squared(
    tmp_path: Path, side: int, voids: int
) -> None:
    hole = square().where(
        lambda x, y: ~((x > 20) & (x < 20 + side) & (y > 30) & (y < 30 + side))
    )
    assert found(hole.write(tmp_path / "a.laz"))["voids"] == voids


def test_distribution_is_the_share_of_the_cells_of_the_worst_swath(tmp_path: Path) -> None:
    # One cell of 1 m in nine has no pulse in the second swath, and the first swath fills it.
    full, sparse = square(), square(source=2)
    sparse = sparse.where(lambda x, y: (x // 1 % 3 != 1) | (y // 1 % 3 != 1))
    found_rows = rows((full + sparse).write(tmp_path / "a.laz"))
    assert found_rows["distribution"]["found"] == pytest.approx(100 * 8 / 9)
    assert found_rows["distribution"]["where"][0].startswith("point source 2: ")
    assert found_rows["distribution_median"]["found"] == pytest.approx(100 * 17 / 18)
    assert found_rows["voids"]["found"] == 0
    # The cells wholly inside are not a multiple of the pattern.
    assert found_rows["swath_density_least"]["found"] == pytest.approx(4 * 8 / 9, rel=0.01)
    assert found_rows["pulse_density"]["found"] == pytest.approx(4 * 17 / 9, rel=0.01)


def test_overlap_is_the_share_of_the_covered_area(tmp_path: Path) -> None:
    swaths = Pulses(*lattice(0, 60, 0, 60), 1) + Pulses(*lattice(40, 100, 0, 60), 2)
    found_rows = found(swaths.write(tmp_path / "a.laz"))
    assert found_rows["swaths"] == 2
    assert found_rows["swath_overlap"] == pytest.approx(20)
    assert found_rows["swath_gaps"] == 0


@pytest.mark.parametrize("width", [4, 10, 30, 90])
def test_a_gap_between_swaths_is_found(tmp_path: Path, width: int) -> None:
    swaths = Pulses(*lattice(0, 40, 0, 120), 1)
    swaths += Pulses(*lattice(40 + width, 80 + width, 0, 120), 2)
    gaps = rows(swaths.write(tmp_path / "a.laz"))
    if width > 4:  # Narrower gaps are closed to the outline, and are voids.
        assert gaps["swath_gaps"]["found"] == 1
        area = float(gaps["swath_gaps"]["where"][0].split("(")[1].split()[0].replace(",", ""))
        assert area == pytest.approx(width * 120, rel=0.3)  # Its ends are rounded.
    assert gaps["swath_gaps"]["found"] + gaps["voids"]["found"] >= 1


PER_SWATH = (
    *("swath_density_median", "swath_density_least", "distribution", "distribution_median"),
    *("swath_overlap", "swath_gaps", "swath_difference", "swath_step", "repeatability"),
)


def test_random_point_source_ids_are_no_swaths(tmp_path: Path) -> None:
    def change(las: Any) -> None:
        ids = np.random.default_rng(1).integers(1, 1 << 16, len(las.x))
        las.point_source_id = ids.astype(np.uint16)

    summary = check_clouds([square(120).write(tmp_path / "a.laz", change=change)], ASKED)
    found_rows = {row["name"]: row for row in summary["rows"]}
    assert found_rows["pulse_density"]["found"] == pytest.approx(4)
    for name in PER_SWATH:
        assert found_rows[name]["found"] is None
        assert found_rows[name]["remark"] == "the point source ids look random"
    [note] = summary["notes"]
    assert note.startswith(f"{found_rows['swaths']['found']:,} point source ids look random")


def test_points_without_source_ids_are_no_swath(tmp_path: Path) -> None:
    cloud = square(60)
    cloud.source[:] = 0
    found_rows = rows(cloud.write(tmp_path / "a.laz"))
    assert found_rows["pulse_density"]["found"] == pytest.approx(4)
    remarks = {"the points have no point source ids", "the points have fewer than two swaths"}
    for name in PER_SWATH:
        assert found_rows[name]["found"] is None
        assert found_rows[name]["remark"] in remarks


@pytest.mark.parametrize("along", ["x", "y"])
def test_many_narrow_swaths_are_not_random(tmp_path: Path, along: str) -> None:
    """150 scan lines of 10 pulses per metre, each with its own id, 1 m apart."""
    x, y = np.meshgrid(np.arange(0, 60, 0.1) + 0.05, np.arange(150) + 0.5)
    lines = Pulses(x.ravel(), y.ravel())
    lines.source = np.repeat(np.arange(150) + 1, x.shape[1])
    if along == "y":
        lines.x, lines.y = lines.y, lines.x
    found_rows = rows(lines.write(tmp_path / "a.laz"))
    assert found_rows["swath_overlap"]["found"] == pytest.approx(0, abs=1)
    assert found_rows["swaths"]["found"] == 150


@pytest.mark.parametrize("degrees", [0, 10, 30, 45, 70])
def test_the_corner_of_two_crossing_swaths_is_no_gap(tmp_path: Path, degrees: int) -> None:
    x, y = lattice(-90, 90, -90, 90)
    angle = math.radians(degrees)
    along = x * math.cos(angle) + y * math.sin(angle)
    across = y * math.cos(angle) - x * math.sin(angle)
    first, second = Pulses(x, y, 1), Pulses(x, y, 2)
    swaths = first.take((abs(along) < 80) & (abs(across) < 20))
    swaths += second.take((abs(across) < 80) & (abs(along) < 20))
    found_rows = found(swaths.write(tmp_path / "a.laz"))
    assert found_rows["swath_gaps"] == 0
    assert found_rows["voids"] == 0


def test_a_lake_at_the_edges_of_two_swaths_is_a_void_and_no_gap(tmp_path: Path) -> None:
    swaths = Pulses(*lattice(0, 60, 0, 80), 1) + Pulses(*lattice(40, 100, 0, 80), 2)
    lake = swaths.where(lambda x, y: (x < 30) | (x > 70) | (y < 20) | (y > 60))
    found_rows = found(lake.write(tmp_path / "a.laz"))
    assert found_rows["voids"] == 1
    assert found_rows["void_area"] == pytest.approx(40 * 40)
    assert found_rows["swath_gaps"] == 0
    assert found_rows["distribution"] == 100


def test_duplicates_in_a_file_and_between_files_are_counted_exactly(tmp_path: Path) -> None:
    pulses = square(20)
    same_place = pulses.take(np.arange(5))
    same_place.time = same_place.time + 1  # Another pulse at the same place is no duplicate.
    first = pulses + pulses.take(np.array([3, 3, 9])) + same_place
    other = Pulses(*lattice(15, 40, 0, 20), 2) + pulses.take(np.flatnonzero(pulses.x > 19))
    paths = [first.write(tmp_path / "a.laz"), other.write(tmp_path / "b.las")]
    expected = 3 + int((pulses.x > 19).sum())
    found_rows = rows(paths)
    assert found_rows["duplicates"]["found"] == expected
    assert found_rows["duplicates"]["where"] == [str(path) for path in paths]


def test_coordinates_with_other_offsets_are_duplicates(tmp_path: Path) -> None:
    def move(las: Any) -> None:
        x = np.array(las.x)
        las.header.offsets = np.array([499_999.7, 4_999_000.3, 0.0])
        las.change_scaling(offsets=las.header.offsets)
        assert np.allclose(las.x, x, atol=1e-6)

    pulses = square(20)
    paths = [pulses.write(tmp_path / "a.laz"), pulses.write(tmp_path / "b.laz", change=move)]
    assert found(paths)["duplicates"] == pulses.x.size


def test_cuts_and_order_of_files_and_points_do_not_show(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    swaths = Pulses(*lattice(0, 60, 0, 60), 1) + Pulses(*lattice(40, 100, 0, 60), 2)
    cloud = swaths.where(lambda x, y: (abs(x - 50) > 6) | (abs(y - 30) > 4))
    cloud = cloud + cloud.take(random.choice(cloud.x.size, 7, replace=False))
    whole = cloud.write(tmp_path / "a.laz")
    shuffled = cloud.take(random.permutation(cloud.x.size))
    parts = [
        shuffled.where(lambda x, y: x + 0.3 * y > 47).write(tmp_path / "b.las"),
        shuffled.where(lambda x, y: x + 0.3 * y <= 47).write(tmp_path / "c.laz"),
    ]
    for spec in (ASKED, None):
        expected = found(whole, spec)
        assert found(parts, spec) == expected
        assert found(parts[::-1], spec) == expected
        assert found(shuffled.write(tmp_path / "d.laz"), spec) == expected
        assert expected["duplicates"] == 7
        # Without a specification, the edges of the cells are not those of the hole.
        assert expected["void_area"] == pytest.approx(12 * 8, rel=0.2 if spec is None else 1e-6)


def test_feet_give_the_figures_of_metres(tmp_path: Path) -> None:
    swaths = Pulses(*lattice(0, 60, 0, 60), 1) + Pulses(*lattice(40, 100, 0, 60), 2)
    cloud = swaths.where(lambda x, y: (abs(x - 50) > 6) | (abs(y - 30) > 4))
    metres = found(cloud.write(tmp_path / "a.laz"))
    feet = found(cloud.write(tmp_path / "b.laz", crs="EPSG:2994", metres=FEET))
    assert feet["pulse_density"] == pytest.approx(metres["pulse_density"], rel=0.03)
    assert feet["void_area"] == pytest.approx(metres["void_area"], rel=0.1)
    assert feet["swath_overlap"] == pytest.approx(metres["swath_overlap"], abs=1)
    assert feet["coordinate_step"] == pytest.approx(0.001 * FEET)


@pytest.mark.parametrize(
    ("crs", "scales", "expected"),
    [
        # Feet of x and y with metres of heights, and the reverse.
        ("EPSG:2994+5703", (0.001, 0.001, 0.01), 0.01),
        ("EPSG:2994+5703", (0.01, 0.001, 0.001), 0.01 * FEET),
        ("EPSG:25832+8228", (0.001, 0.001, 0.01), 0.01 * FEET),
        ("EPSG:25832+8228", (0.001, 0.005, 0.01), 0.005),
        ("EPSG:2994", (0.001, 0.001, 0.01), 0.01 * FEET),
    ],
)
def test_the_coordinate_step_has_the_unit_of_each_axis(
    tmp_path: Path, crs: str, scales: tuple[float, float, float], expected: float
) -> None:
    def change(las: Any) -> None:
        las.change_scaling(scales=np.array(scales))

    path = square(20).write(tmp_path / "a.laz", crs=crs, change=change)
    assert found(path)["coordinate_step"] == pytest.approx(expected)


def test_the_side_of_cells_follows_the_density_without_a_specification(tmp_path: Path) -> None:
    # The bounds are four times as large as the area of the points.
    islands = Pulses(*lattice(0, 40, 0, 40)) + Pulses(*lattice(80, 120, 80, 120))
    summary = check_clouds([islands.write(tmp_path / "a.laz")])
    assert summary["cell_m"] == pytest.approx(1, rel=0.1)
    density = next(r for r in summary["rows"] if r["name"] == "pulse_density")
    assert density["found"] == pytest.approx(4, rel=0.1)
    assert {row["state"] for row in summary["rows"]} == {"not asked"}


@pytest.mark.parametrize("far", [6e4, 1e6])
@pytest.mark.parametrize("spec", [ASKED, None])
def test_a_stray_is_left_out_of_the_rows_of_cells_and_named(
    tmp_path: Path, far: float, spec: Specification | None
) -> None:
    swaths = square() + Pulses(*lattice(40, 100, 0, 60), 2)
    without = found(swaths.write(tmp_path / "a.laz"), spec)
    swaths.x[-1] = swaths.y[-1] = far
    summary = check_clouds([swaths.write(tmp_path / "b.laz")], spec)
    with_stray = {row["name"]: row["found"] for row in summary["rows"]}
    for name in ("pulse_density", "swath_overlap", "swath_density_least", "distribution"):
        assert with_stray[name] == pytest.approx(without[name], rel=0.03)
    assert (with_stray["swath_gaps"], with_stray["voids"]) == (0, 0)
    [note] = (note for note in summary["notes"] if "far from all others" in note)
    x, y = (float(text) for text in note.rsplit(" ", 2)[1:])
    assert (x, y) == pytest.approx((5e5 + far, 5e6 + far), abs=1)
    assert note.startswith(f"{tmp_path / 'b.laz'}: 1 first return ")


def test_many_points_far_away_are_no_strays_and_have_a_reason(tmp_path: Path) -> None:
    cloud = square()
    cloud.x[:20] = cloud.y[:20] = 1e6
    density = rows(cloud.write(tmp_path / "a.laz"))["pulse_density"]
    assert density["state"] == "not measured"
    assert "far from it" in density["remark"]


@pytest.mark.parametrize("n_east", [1, 2])
def test_clouds_that_lie_far_apart_are_no_strays_and_are_named(
    n_east: int, tmp_path: Path
) -> None:
    """The cells are around two files in the east, or between one there and the one in the west."""
    paths = []
    for number in range(n_east + 1):
        cloud = Pulses(*lattice(0, 10, 0, 10, 0.1), number + 1)
        cloud.x += 2e6 + 10 * number if number else -2e6
        cloud.z[:] = 100
        paths.append(cloud.write(tmp_path / f"{number}.laz"))
    summary = check_clouds(paths)
    density = next(row for row in summary["rows"] if row["name"] == "pulse_density")
    assert (density["found"], density["state"]) == (None, "not asked")
    assert "farther apart than cells reach" in density["remark"]
    (note,) = summary["notes"]
    named = paths[:1] if n_east == 2 else paths
    assert note.startswith(f"{', '.join(map(str, named))}: the clouds lie farther apart")
    assert f"{10_000 * len(named):,} first returns of these files" in note
    assert found(paths[0])["pulse_density"] == pytest.approx(100)


def test_facts_of_headers_and_fields(tmp_path: Path) -> None:
    def spoil(las: Any) -> None:
        las.return_number[:4] = 0
        las.return_number[4:6] = 3
        las.point_source_id[:10] = 0
        las.classification[:3] = [0, 7, 18]
        las.overlap[:2] = las.synthetic[:3] = las.key_point[:4] = 1
        las.intensity[:] = 0
        las.header.global_encoding.gps_time_type = laspy.header.GpsTimeType.WEEK_TIME

    cloud = square(20)
    paths = [
        cloud.write(tmp_path / "a.laz", crs="EPSG:25832", change=spoil),
        square(20).write(tmp_path / "b.las", point_format=7),
    ]
    found_rows = found(paths)
    assert found_rows["las_version"] == ["1.4"]
    assert found_rows["point_format"] == [6, 7]
    assert found_rows["files_without_vertical_crs"] == 1
    assert (found_rows["files_without_crs"], found_rows["different_crs"]) == (0, 1)
    assert found_rows["gps_time"] == [
        "adjusted standard",
        "week seconds, but some are outside a week",
    ]
    assert found_rows["wrong_return_numbers"] == 6
    assert found_rows["points_without_source"] == 10
    assert found_rows["classes"] == [0, 2, 7, 18]
    flags = [found_rows[f"{n}_points"] for n in ("overlap", "synthetic", "key", "withheld")]
    assert flags == [2, 3, 4, 0]
    assert found_rows["files_without_intensity"] == 1
    assert found_rows["points_outside_bounds"] == 0


@pytest.mark.parametrize(
    ("bit", "time", "kind"),
    [
        (1, 3e8, "adjusted standard"),
        (1, -3e8, "adjusted standard"),
        (1, 4e5, "adjusted standard, but all are those of a week"),
        (0, 4e5, "week seconds"),
        (0, 3e8, "week seconds, but some are outside a week"),
    ],
)
def test_the_kind_of_times_is_that_of_the_header_if_they_fit(
    tmp_path: Path, bit: int, time: float, kind: str
) -> None:
    def change(las: Any) -> None:
        las.header.global_encoding.gps_time_type = laspy.header.GpsTimeType(bit)
        las.gps_time[:] = time + np.arange(las.gps_time.size)
        las.gps_time[0] = np.nan

    counts = count_file(square(5).write(tmp_path / "a.laz", change=change), None, None)
    assert counts.times_kind == kind


def test_a_wrong_header_is_found(tmp_path: Path) -> None:
    path = square(20).write(tmp_path / "a.las")
    raw = bytearray(path.read_bytes())
    raw[255:263] = (5).to_bytes(8, "little")  # points of the first return
    raw[179:187] = np.float64(5e5 + 10).tobytes()  # largest x
    path.write_bytes(raw)
    found_rows = found(path)
    assert found_rows["files_with_wrong_returns"] == 1
    assert found_rows["points_outside_bounds"] == 40 * 20


def test_different_crs_leave_cells_unmeasured(tmp_path: Path) -> None:
    paths = [
        square(20).write(tmp_path / "a.laz"),
        square(20).write(tmp_path / "b.laz", crs="EPSG:2154"),
    ]
    found_rows = rows(paths)
    assert found_rows["different_crs"]["found"] == 2
    assert found_rows["pulse_density"]["state"] == "not measured"
    assert found_rows["pulse_density"]["remark"] == "the files have different CRSs"


def test_degrees_and_empty_clouds_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is geographic, not projected"):
        found(square(20).write(tmp_path / "a.laz", crs="EPSG:4326"))
    nothing = square(20).take(np.arange(0))
    with pytest.raises(InputError, match="no points in 1 file"):
        found(nothing.write(tmp_path / "b.laz", crs=ALL))


@pytest.mark.parametrize("n", [1, 2])
def test_a_few_points_at_one_place_next_to_an_empty_file_have_rows(
    tmp_path: Path, n: int
) -> None:
    few = square(20).take(np.zeros(n, np.intp))
    paths = [
        few.take(np.arange(0)).write(tmp_path / "a.laz"),
        few.write(tmp_path / "b.laz"),
    ]
    found_rows = found(paths, None)
    assert found_rows["duplicates"] == n - 1
    assert found_rows["pulse_density"] > 0
    assert found_rows["swath_density_least"] is None


def test_vertical_crs_that_differ_are_told(tmp_path: Path) -> None:
    paths = [
        square(20).write(tmp_path / "a.laz", "EPSG:25832+5783"),
        square(20).write(tmp_path / "b.laz", "EPSG:25832+7837"),
    ]
    assert found(paths)["different_vertical_crs"] == 2
    assert found(paths[:1])["different_vertical_crs"] == 1


def test_crs_of_one_name_differ(tmp_path: Path) -> None:
    local = "+proj=tmerc +lat_0=0 +lon_0={} +x_0=500000 +ellps=GRS80 +units=m"
    paths = [
        square(20).write(tmp_path / f"{lon}.laz", local.format(lon)) for lon in ("9", "10")
    ]
    assert found(paths)["different_crs"] == 2


def test_times_that_were_not_adjusted_are_told(tmp_path: Path) -> None:
    def unadjusted(las: Any) -> None:
        las.gps_time += 1e9

    path = square(20).write(tmp_path / "a.laz", change=unadjusted)
    assert found(path)["gps_time"] == ["standard, but not adjusted"]


def test_duplicates_outside_the_bounds_are_not_called_none(tmp_path: Path) -> None:
    paths = [square(20).write(tmp_path / name) for name in ("a.las", "b.las")]
    for path in paths:
        with path.open("r+b") as stream:
            stream.seek(179)  # highest x, after which no point of the other file is near
            stream.write(np.float64(500_001.0).tobytes())
    duplicates = rows(paths)["duplicates"]
    assert duplicates["found"] is None
    assert duplicates["remark"].startswith(
        "1,600 points at least; points lie outside the bounds"
    )


def test_workers_change_nothing(tmp_path: Path) -> None:
    paths = [square().write(tmp_path / name) for name in ("a.laz", "b.laz")]
    assert check_clouds(paths, ASKED, workers=1) == check_clouds(paths, ASKED)


def test_cells_that_need_more_than_the_memory_are_not_examined(tmp_path: Path) -> None:
    cloud = square()
    cloud.x[:20] = cloud.y[:20] = 3e3
    summary = check_clouds([cloud.write(tmp_path / "a.laz")], ASKED, memory=300 * 2**20)
    density = next(row for row in summary["rows"] if row["name"] == "pulse_density")
    assert density["found"] is None
    assert "more with --memory" in density["remark"]


def test_too_little_memory_is_refused(tmp_path: Path) -> None:
    path = square().write(tmp_path / "a.laz")
    with pytest.raises(ConfigError, match="needs 256.0 MiB or more"):
        check_clouds([path], memory=100_000_000)


def test_a_process_that_needs_more_memory_can_get_it() -> None:
    told = "a.laz: the process that reads it needs more than the 256 MiB; get the file again"
    with (
        pytest.raises(InputError, match="256 MiB; give more with --memory$"),
        _remedies_of_check(),
    ):
        raise InputError(told) from ChildMemoryError()
