"""Several resolutions in one run: their folders, heights that agree, and what other commands say of their OUT."""

from __future__ import annotations

import json
import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import rasterio

from cli.main import main
from tests.invariants import clouds
from tests.invariants.runs import output_digests, settings
from tests.scenes.drawings import ground, written
from tiler.apps.resolutions import folder_name, run_resolutions
from tiler.config import RunConfig
from tiler.core.units import US_SURVEY_FOOT, parse_length
from tiler.errors import ConfigError
from tiler.pipeline import RunResult, run
from tiler.simulate import DemoScene

FEW = {"tile_size": "128", "water": "auto"}

Made = tuple[Path, RunResult, list[str]]


@pytest.fixture(scope="module")
def made(demo: DemoScene, tmp_path_factory: pytest.TempPathFactory) -> Made:
    """OUT of a run with pixels of 1 and 3 m, its result, and its inputs. Not to be changed."""
    out, inputs = tmp_path_factory.mktemp("several") / "out", [str(path) for path in demo.paths]
    return out, run_resolutions(inputs, out, settings(resolution="3,1", **FEW)), inputs


def test_each_resolution_has_a_folder(made: Made) -> None:
    out, result, _ = made
    assert {path.name for path in out.iterdir()} == {"1m", "3m", "report.html", "store.zarr"}
    assert [Path(one.out).name for one in (result, *result.others)] == ["1m", "3m"]
    for folder, pixel in (("1m", 1.0), ("3m", 3.0)):
        with rasterio.open(out / folder / "dtm.tif") as raster:
            assert raster.res == (pixel, pixel)
    assert (out / "1m/classified.vpc").is_file()
    assert not (out / "3m/classified").exists()


def test_the_finest_has_the_bytes_of_a_run_alone(made: Made, tmp_path: Path) -> None:
    out, _, inputs = made
    run(inputs, tmp_path, settings(**FEW))
    assert output_digests(tmp_path) == output_digests(out / "1m")


def assert_heights_agree(fine: Path, coarse: Path) -> None:
    """Pixels whose centre is also that of a finer one have its height."""
    with rasterio.open(coarse) as of_coarse, rasterio.open(fine) as of_fine:
        rows, cols = np.indices(of_coarse.shape)
        x, y = of_coarse.transform @ (cols + 0.5, rows + 0.5)
        col, row = (np.floor(part).astype(int) for part in ~of_fine.transform @ (x, y))
        inside = (row >= 0) & (row < of_fine.height) & (col >= 0) & (col < of_fine.width)
        heights = of_coarse.read(1)[inside]
        at_centres = of_fine.read(1)[row[inside], col[inside]]
    both = (heights != -9999) & (at_centres != -9999)
    assert both.mean() > 0.95
    np.testing.assert_array_equal(heights[both], at_centres[both])


def test_heights_agree_where_the_centres_of_pixels_do(made: Made) -> None:
    assert_heights_agree(made[0] / "1m/dtm.tif", made[0] / "3m/dtm.tif")


def test_all_resolutions_have_the_water_that_the_finest_finds(tmp_path: Path) -> None:
    cloud = ground(lambda x, y: 30 + 0.2 * np.clip(np.hypot(x - 18, y - 20) - 9, 0, 12))
    x, y = cloud.xyz[:, :2].T
    seen = (np.hypot(x - 18, y - 20) > 9) | (np.random.default_rng(4).random(len(x)) < 0.02)
    pond = clouds.Cloud(cloud.xyz[seen], cloud.truth[seen])
    path = written(tmp_path / "pond.laz", pond)
    config = settings(resolution="1,3", method="keep", water="auto", water_min_lake="150")
    fine = run_resolutions([str(path)], tmp_path / "out", config)
    coarse = fine.others[0]
    levels = [[body["level"] for body in one.summary["water"]] for one in (fine, coarse)]
    assert len(levels[0]) == 1
    assert levels[1] == levels[0]
    assert_heights_agree(Path(fine.out, "dtm.tif"), Path(coarse.out, "dtm.tif"))


def test_the_page_links_to_files_that_exist(made: Made) -> None:
    out = made[0]
    page = (out / "report.html").read_text("utf-8")
    links = re.findall(r'href="([^"#]+)"', page)
    assert {"1m/dtm.tif", "1m/report.html", "3m/dtm.tif", "3m/report.html"} <= set(links)
    assert all((out / link).is_file() for link in links if not link.startswith("data:"))
    assert "<script" not in page


def test_again_there_is_nothing_to_do(made: Made) -> None:
    out, _, inputs = made
    before = {
        p: p.stat().st_mtime_ns for folder in ("1m", "3m") for p in out.glob(f"{folder}/*.tif")
    }
    again = run_resolutions(inputs, out, settings(resolution="1,3", **FEW))
    assert again.did_nothing
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_stages_before_the_last_make_the_finest(cloud: Path, tmp_path: Path) -> None:
    result = run_resolutions([str(cloud)], tmp_path, settings(resolution="1,2"), until="filter")
    assert (Path(result.out).name, result.others) == ("1m", ())
    assert not (tmp_path / "2m").exists()


def test_json_has_a_run_for_each_folder(
    cloud: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--method", "classic", "--water", "none", "--in-process", "--resolution", "2,4"]
    assert main(["run", str(cloud), "-o", str(tmp_path), "--json", *options]) == 0
    summaries = json.loads(capsys.readouterr().out)
    found = {name: run["dtm"]["resolution_m"] for name, run in summaries.items()}
    assert found == {"2m": 2.0, "4m": 4.0}
    assert main(["run", str(cloud), "-o", str(tmp_path), *options]) == 0
    lines = capsys.readouterr().out.splitlines()
    heads = [line.split()[-1] for line in lines if line.startswith("resolution")]
    assert heads == [str(tmp_path / name) for name in found]
    assert lines[-1] == f"all         {tmp_path / 'report.html'}"


@pytest.mark.parametrize(
    "command", [["deliver", "--to", "D"], ["review"], ["check"], ["report"]]
)
def test_commands_name_the_folders(
    command: list[str], made: Made, capsys: pytest.CaptureFixture[str]
) -> None:
    out = made[0]
    assert main([command[0], str(out), *command[1:]]) in (2, 3)
    assert f"{out / '1m'}, {out / '3m'}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("written", "folder"),
    [
        ("1", "1m"),
        ("0.5", "0.5m"),
        ("50cm", "0.5m"),
        ("1/3", "0.333333m"),
        ("2ft", "2ft"),
        ("0.5usft", "0.5ft"),
        ("0.6096", "0.6096m"),
    ],
)
def test_name_of_a_folder(written: str, folder: str) -> None:
    assert folder_name(parse_length(written)) == folder


def test_name_of_a_folder_of_survey_feet() -> None:
    assert folder_name(Fraction(3) * US_SURVEY_FOOT) == "3ft"


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("2", Fraction(2)),
        ("2,0.5", (Fraction(1, 2), Fraction(2))),
        ([1, "50cm"], (Fraction(1, 2), Fraction(1))),
        ([0.25], Fraction(1, 4)),
    ],
)
def test_resolutions_are_read_in_ascending_order(
    given: object, expected: Fraction | tuple[Fraction, ...]
) -> None:
    assert RunConfig.from_mapping({"resolution": given}).resolution == expected


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("1,1.0", "twice"),
        ("1,2,3,4,5", "at most 4"),
        ("1,,2", "not a length"),
        ("1,0", "must be above 0"),
        ([], "is empty"),
    ],
)
def test_wrong_resolutions(given: object, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        RunConfig.from_mapping({"resolution": given})


def test_an_out_of_one_resolution_is_refused_with_its_store(
    city_run: Path, cloud: Path, tmp_path: Path
) -> None:
    with pytest.raises(
        ConfigError, match="one resolution; give another folder, and --store"
    ) as error:
        run_resolutions([str(cloud)], city_run, settings(resolution="1,2"))
    assert str(city_run / "store.zarr") in str(error.value)


def test_a_page_of_somebody_else_is_kept(cloud: Path, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    page.write_text("mine")
    with pytest.raises(ConfigError, match="is not a page of this command"):
        run_resolutions([str(cloud)], tmp_path, settings(resolution="1,2"))
    assert page.read_text() == "mine"
    with pytest.raises(ConfigError, match="is a URL"):
        run_resolutions([str(cloud)], "s3://bucket/out", settings(resolution="1,2"))
