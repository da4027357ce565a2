"""Two surveys of a place: the newer one counts, with a ramp to the older one 0.3 m above it."""

from __future__ import annotations

from datetime import date
from fractions import Fraction
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import numpy.typing as npt
import pytest
import rasterio

from tests.invariants.runs import all_digests, computed, do
from tests.invariants.runs import dtm as read_dtm
from tests.invariants.runs import settings as run_settings
from tiler.apps.clean import clean
from tiler.pipeline import RunResult
from tiler.plan import make_plan

WEST, SOUTH = 500_000.0, 5_400_000.0
OLD, NEW = (0, 0, 130, 120), (60, 20, 170, 100)
"""West, south, east and north of each survey, as far as the corner."""
HOUSE = (100, 50, 116, 66)
STEP_M = 0.3

Heights = npt.NDArray[np.float64]


def terrain(x: Heights, y: Heights) -> Heights:
    return 100 + 0.02 * x + np.sin(y / 20)


def within(x: Heights, y: Heights, area: tuple[int, ...], margin: float = 0.0) -> Any:
    west, south, east, north = area
    inside = (x >= west + margin) & (x < east - margin)
    return inside & (y >= south + margin) & (y < north - margin)


def write(path: Path, xyz: Heights, day: date) -> Path:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.array([WEST, SOUTH, 0.0])
    header.creation_date = day
    points = laspy.ScaleAwarePointRecord.zeros(len(xyz), header=header)
    points["x"], points["y"], points["z"] = (xyz + (WEST, SOUTH, 0.0)).T
    points["return_number"] = points["number_of_returns"] = np.ones(len(xyz), np.uint8)
    cloud = laspy.LasData(header)
    cloud.points = points
    path.parent.mkdir(exist_ok=True)
    cloud.write(path)
    return path


def survey(area: tuple[int, ...], density: int, seed: int) -> Heights:
    rng = np.random.default_rng(seed)
    west, south, east, north = area
    n = (east - west) * (north - south) * density
    x, y = rng.uniform(west, east, n), rng.uniform(south, north, n)
    return np.column_stack([x, y, terrain(x, y) + rng.normal(0, 0.02, n)])


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("surveys")
    old, new = survey(OLD, 4, 1), survey(NEW, 6, 2)
    old[:, 2] += STEP_M
    new[within(new[:, 0], new[:, 1], HOUSE), 2] += 6
    west = new[:, 0] < 110
    return {
        "old": write(folder / "old.laz", old, date(2015, 5, 1)),
        "new": write(folder / "new.laz", new, date(2023, 5, 1)),
        "new_west": write(folder / "new_west.laz", new[west], date(2023, 5, 1)),
        "new_east": write(folder / "new_east.laz", new[~west], date(2023, 5, 9)),
    }


def made(paths: list[Path], out: Path, **settings: Any) -> RunResult:
    settings = {
        "crs": "EPSG:25832",
        "kind": "als",
        "halo": "40",
        "classified": "laz",
        **settings,
    }
    result = do(paths, out, **settings)
    assert result.exit_code == 0
    return result


@pytest.fixture(scope="module")
def runs(files: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("runs")
    results: dict[str, Any] = {"folder": folder}
    both = [files["old"], files["new"]]
    results["both"] = made(both, folder / "both", priority="newest", products="dtm,dsm")
    for name in ("old", "new"):
        results[name] = made([files[name]], folder / name)
    return results


def heights(out: Path) -> tuple[Heights, Heights, Heights]:
    """Heights on the pixels of the old survey and of the new one, and the middles of these pixels."""
    values, transform = read_dtm(out)
    x, y = np.meshgrid(np.arange(0.5, 170), np.arange(0.5, 120))
    columns = np.floor(x + WEST - transform.c).astype(int)
    rows = np.floor(transform.f - y - SOUTH).astype(int)
    there = (
        (columns >= 0) & (rows >= 0) & (columns < values.shape[1]) & (rows < values.shape[0])
    )
    found = np.full(x.shape, np.nan)
    found[there] = values[rows[there], columns[there]]
    return found, x, y


def test_inside_the_newer_survey_the_terrain_is_its_own(runs: dict[str, Any]) -> None:
    both, x, y = heights(runs["folder"] / "both")
    alone, _, _ = heights(runs["folder"] / "new")
    inside = within(x, y, NEW, 3)
    np.testing.assert_array_equal(both[inside], alone[inside])
    # No point of the older one below the house is ground.
    assert abs(both - terrain(x, y))[inside].max() < 0.1


def test_outside_it_is_that_of_the_older_one(runs: dict[str, Any]) -> None:
    both, x, y = heights(runs["folder"] / "both")
    alone, _, _ = heights(runs["folder"] / "old")
    outside = within(x, y, OLD, 1) & ~within(x, y, NEW, -9)
    np.testing.assert_array_equal(both[outside], alone[outside])


def test_the_seam_is_a_ramp(runs: dict[str, Any]) -> None:
    both, x, y = heights(runs["folder"] / "both")
    rows = within(x, y, (0, 30, 170, 90)).any(axis=1)
    above = np.median((both - terrain(x, y))[rows], axis=0)
    assert above[:54] == pytest.approx(STEP_M, abs=0.02)
    assert above[61:120] == pytest.approx(0, abs=0.02)
    ramp = above[54:62]
    assert (np.diff(ramp) < 0.01).all()  # Noise of the heights
    assert np.diff(ramp).min() > -STEP_M / 2  # No step of a single pixel


def test_what_each_survey_gave_is_told(runs: dict[str, Any], files: dict[str, Path]) -> None:
    summary = runs["both"].summary
    new, old = summary["surveys"]
    old_xy = laspy.read(files["old"]).xyz[:, :2] - (WEST, SOUTH)
    assert (new["name"], old["name"]) == ("2023-05-01", "2015-05-01")
    assert new["points"] == new["used"] == 52_800
    assert (old["points"], new["steps"]) == (len(old_xy), [])
    # Cells of 2 m, whose edges lie on the border of the newer survey.
    counts = (~within(*old_xy.T, NEW, -4.0)).sum()
    assert old["used"] == pytest.approx(counts, rel=0.01)
    assert summary["counts"]["unselected"] == {"priority": old["points"] - old["used"]}
    areas = [(170 - 60) * 80, 130 * 120 - (130 - 56) * 88]
    assert [new["area_m2"], old["area_m2"]] == pytest.approx(areas, rel=0.01)
    (step,) = old["steps"]
    assert step["other"] == new["name"]
    assert step["median_m"] == pytest.approx(STEP_M, abs=0.02)
    assert step["mad_m"] < 0.03
    assert step["cells"] > 800
    assert any("0.30 m above 2023-05-01" in text for text in runs["both"].warnings)
    report = (runs["folder"] / "both" / "report.html").read_text("utf-8")
    assert "+0.30 m to 2023-05-01" in report
    assert (
        "2 surveys by the days in the headers, the first counts most: 2023-05-01 (1 file), 2015-05-01 (1 file)"
        in " ".join(runs["both"].notes)
    )


def test_clouds_keep_all_points_and_the_class_of_those_that_do_not_count(
    runs: dict[str, Any], files: dict[str, Path]
) -> None:
    before = laspy.read(files["old"])
    after = laspy.read(runs["folder"] / "both" / "classified" / "old.laz")
    np.testing.assert_array_equal(before.xyz, after.xyz)
    x, y, _ = (before.xyz - (WEST, SOUTH, 0)).T
    assert (np.asarray(after.classification)[within(x, y, NEW)] == 0).all()
    outside = ~within(x, y, NEW, -6)
    assert (np.asarray(after.classification)[outside] == 2).mean() > 0.9


@pytest.mark.parametrize("case", ["order", "cut", "buckets"])
def test_order_cut_and_buckets_change_no_byte(
    runs: dict[str, Any],
    files: dict[str, Path],
    tmp_path: Path,
    case: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    both = [files["old"], files["new"]]
    if case == "cut":
        both = [files["new_west"], files["old"], files["new_east"]]
    if case == "buckets":
        monkeypatch.setattr("tiler.plan.sizes.BUCKETS_M", (16,))
    result = made(both[::-1], tmp_path, priority="newest", products="dtm,dsm")
    np.testing.assert_array_equal(read_dtm(tmp_path)[0], read_dtm(runs["folder"] / "both")[0])
    if case != "cut":
        assert all_digests(tmp_path) == all_digests(runs["folder"] / "both")
    sides = [run.summary["plan"]["bucket_m"] for run in (result, runs["both"])]
    assert (sides[0] < sides[1]) == (case == "buckets")
    first = runs["both"].summary["surveys"]
    facts = ("points", "used", "area_m2")
    assert [[s[f] for f in facts] for s in result.summary["surveys"]] == [
        [s[f] for f in facts] for s in first
    ]
    assert [step["median_m"] for step in result.summary["surveys"][1]["steps"]] == [
        step["median_m"] for step in first[1]["steps"]
    ]


def test_a_part_has_the_terrain_of_the_whole(
    runs: dict[str, Any], files: dict[str, Path], tmp_path: Path
) -> None:
    west, south, east, north = 40, 60, 80, 90
    bounds = [WEST + west, SOUTH + south, WEST + east, SOUTH + north]
    made([files["old"], files["new"]], tmp_path, priority="newest", bounds=bounds)
    part, x, y = heights(tmp_path)
    whole, _, _ = heights(runs["folder"] / "both")
    inside = within(x, y, (west, south, east, north))
    np.testing.assert_array_equal(part[inside], whole[inside])


@pytest.mark.processes
def test_workers_give_the_same_bytes(
    runs: dict[str, Any], files: dict[str, Path], tmp_path: Path
) -> None:
    both = [files["old"], files["new"]]
    made(both, tmp_path, priority="newest", products="dtm,dsm", in_process=False, workers=2)
    assert all_digests(tmp_path) == all_digests(runs["folder"] / "both")


def test_another_priority_repeats_what_it_changes(
    files: dict[str, Path], tmp_path: Path
) -> None:
    both = [files["old"], files["new"]]
    out, lines = tmp_path / "out", tmp_path / "surveys.txt"
    made(both, out)
    plain = all_digests(out)
    lines.write_text("old.laz\n")
    for settings in ({"priority": "newest"}, {"priority": str(lines)}):
        clean(out)  # The decoded points are gone and have to be read again.
        result = made(both, out, **settings)
        assert computed(result)["assemble"] > 0
        made(both, tmp_path / "fresh", overwrite=True, **settings)
        assert all_digests(out) == all_digests(tmp_path / "fresh")
        assert all_digests(out) != plain
    # The same surveys in other words are the same work.
    lines.write_text("# The older one\n*old.laz\n*new.laz\n")
    assert not any(computed(made(both, out, priority=str(lines))).values())
    made(both, out)
    assert all_digests(out) == plain


def test_a_survey_elsewhere_leaves_the_buckets_alone(
    files: dict[str, Path], tmp_path: Path
) -> None:
    """The ranks of the others change, but not which of them counts."""
    both, out = [files["old"], files["new"]], tmp_path / "out"
    first = made(both, out, priority="newest")
    far = survey((1000, 0, 1060, 60), 4, 3)
    third = write(tmp_path / "third.laz", far, date(2026, 1, 1))
    result = made([*both, third], out, priority="newest")
    assert result.summary["surveys"][0]["name"] == "2026-01-01"
    before = first.summary["stages"]["assemble"]["tasks"]
    stage = result.summary["stages"]["assemble"]
    assert (stage["done"], stage["tasks"] - stage["computed"]) == (before, before)


def test_noise_of_the_newer_survey_beyond_its_border_is_found_beside_the_older_one(
    files: dict[str, Path], tmp_path: Path
) -> None:
    """Points 0.8 m below the terrain, far from one another, where the newer survey has no others."""
    x, y = np.meshgrid(np.arange(8.0, 50, 14), np.arange(8.0, 110, 14))
    low = np.column_stack([x.ravel(), y.ravel(), terrain(x, y).ravel() + STEP_M - 0.8])
    new = np.concatenate([survey(NEW, 6, 2), low])
    noisy = write(tmp_path / "noisy.laz", new, date(2023, 5, 1))
    made([files["old"], noisy], tmp_path / "out", priority="newest", method="auto")
    found, x, y = heights(tmp_path / "out")
    west = within(x, y, (0, 0, 54, 120), 2)
    assert np.abs(found - terrain(x, y) - STEP_M)[west].max() < 0.2


def test_a_sparse_survey_before_a_dense_one_is_warned_of(
    files: dict[str, Path], tmp_path: Path
) -> None:
    x, y = np.meshgrid(np.arange(60.5, 170, 4), np.arange(20.5, 100, 4))
    thin = np.column_stack([x.ravel(), y.ravel(), terrain(x, y).ravel()])
    sparse = write(tmp_path / "sparse.laz", thin, date(2023, 5, 1))
    result = made([files["old"], sparse], tmp_path / "out", priority="newest")
    [doubt] = result.summary["doubts"]
    assert "which is much denser" in doubt
    assert doubt in result.warnings
    assert doubt in [problem["why"] for problem in result.summary["problems"]]
    assert any("no step to other surveys was measured" in text for text in result.notes)


def test_a_step_of_a_geoid_height_is_told_in_full(
    files: dict[str, Path], tmp_path: Path
) -> None:
    high = survey(NEW, 6, 2) + (0, 0, 47.3)
    other = write(tmp_path / "high.laz", high, date(2023, 5, 1))
    result = made([files["old"], other], tmp_path / "out", priority="newest")
    [doubt] = result.summary["doubts"]
    assert "lies 47.00 m below" in doubt
    assert doubt in result.warnings


def test_the_plan_has_the_pixel_of_the_run(tmp_path: Path) -> None:
    """The older survey has 4 points per m2, and the newer one, which counts, a point per 2 m2."""
    new = survey(NEW, 2, 2)[::4]
    inside = tuple(side + margin for side, margin in zip(NEW, (5, 5, -5, -5), strict=True))
    paths = [
        write(tmp_path / "old.laz", survey(inside, 4, 1), date(2015, 5, 1)),
        write(tmp_path / "new.laz", new, date(2023, 5, 1)),
    ]
    settings = {"crs": "EPSG:25832", "kind": "als", "resolution": None}
    pixels = {}
    for priority in ("newest", None):
        how = {**settings, "priority": priority}
        pixels[priority] = make_plan(
            [str(p) for p in paths], run_settings(**how)
        ).grid.resolution
    assert pixels == {"newest": Fraction(3, 2), None: 1}
    made(paths, tmp_path / "out", **settings, priority="newest")
    with rasterio.open(tmp_path / "out/dtm.tif") as raster:
        assert raster.res == (1.5, 1.5)
