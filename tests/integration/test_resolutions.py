"""Several resolutions in one run: their folders, heights that agree, and what other commands say of their OUT."""

from __future__ import annotations

import json
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
import rasterio
from laspy.header import GpsTimeType

from cli.main import main
from tests.invariants import clouds
from tests.invariants.runs import output_digests, settings
from tests.scenes.drawings import ground, written
from tiler.apps.clean import clean
from tiler.apps.resolutions import (
    _write_page,
    folder_name,
    plan_resolutions,
    run_resolutions,
)
from tiler.config import RunConfig
from tiler.core.units import US_SURVEY_FOOT, parse_length
from tiler.errors import ConfigError, ProcessingError
from tiler.observe.json_lines import Progress, ProgressRecords
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


def test_all_have_the_date_of_the_survey(cloud: Path, tmp_path: Path) -> None:
    las = laspy.convert(laspy.read(cloud), point_format_id=6)
    las.header.global_encoding.gps_time_type = GpsTimeType.STANDARD
    las.gps_time = np.full(
        len(las), 3.5e8
    )  # Seconds from 2011-09-14, a billion after the GPS epoch.
    las.write(tmp_path / "timed.laz")
    result = run_resolutions(
        [str(tmp_path / "timed.laz")], tmp_path / "out", settings(resolution="1,2")
    )
    for one in (result, *result.others):
        assert one.summary["dates"]["first"] == "2022-10-17"
        stac = json.loads(Path(one.out, "stac.json").read_text())
        assert stac["properties"]["datetime"].startswith("2022-10-17")


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
        ("0.6096", "2ft"),
        ("3", "3m"),
        ("0.61", "0.61m"),
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


def test_what_out_cannot_be(cloud: Path, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    page.write_text("mine")
    for out, words in (
        (str(tmp_path), "report.html: already exists and was not written by a run"),
        ("s3://bucket/out", "is a URL"),
        ("", "has no name"),
        (str(tmp_path / "out.tif"), "has the name of a file"),
    ):
        with pytest.raises(ConfigError, match=words):
            run_resolutions([str(cloud)], out, settings(resolution="1,2"))
    assert page.read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == []


def test_two_resolutions_have_two_names(cloud: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="same 6 digits"):
        run_resolutions([str(cloud)], tmp_path, settings(resolution="1/3,0.333333"))


def test_a_resolution_that_cannot_be_made_ends_the_run_at_its_start(
    cloud: Path, tmp_path: Path
) -> None:
    config = settings(resolution="0.5,3", sheets="25")
    with pytest.raises(ConfigError, match="whole number of pixels of 3 m"):
        plan_resolutions([str(cloud)], config, tmp_path)
    with pytest.raises(ConfigError, match="whole number of pixels of 3 m"):
        run_resolutions([str(cloud)], tmp_path, config)
    assert list(tmp_path.iterdir()) == [cloud]


def test_a_plan_of_a_finished_run_is_accepted(
    made: Made, capsys: pytest.CaptureFixture[str]
) -> None:
    out, _, inputs = made
    assert main(["plan", *inputs, "-o", str(out), "--resolution", "1,3"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in lines if line.startswith("resolution")] == ["1m", "3m"]


def test_the_page_tells_of_a_run_that_did_not_end(
    cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, out = settings(resolution="1,2"), tmp_path / "out"
    run_resolutions([str(cloud)], out, config)
    assert ">Finished<" in (out / "report.html").read_text("utf-8")

    def interrupted(*arguments: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tiler.apps.resolutions.run", interrupted)
    monkeypatch.setattr("tiler.apps.resolutions._write_page", _write_first)
    with pytest.raises(KeyboardInterrupt):
        run_resolutions([str(cloud)], out, config)
    page = (out / "report.html").read_text("utf-8")
    assert ">Not finished<" in page
    assert ">Finished<" not in page


def _write_first(out: Path, plans: Any, is_running: bool = False) -> None:
    """Write only the page of the start, as if the process were killed later."""
    if is_running:
        _write_page(out, plans, is_running)


def test_a_damaged_run_file_does_not_hide_the_error_that_ended_the_run(
    cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(inputs: Any, out: Path, *rest: Any) -> RunResult:
        Path(out).mkdir(parents=True)
        keys = ("version", "configuration", "plan", "stages")
        Path(out, "run.json").write_text(json.dumps({"state": "done"} | dict.fromkeys(keys)))
        raise ProcessingError("the tile cannot be filtered")

    monkeypatch.setattr("tiler.apps.resolutions.run", fail)
    with pytest.raises(ProcessingError, match="the tile cannot be filtered"):
        run_resolutions([str(cloud)], tmp_path / "out", settings(resolution="1,2"))


def test_a_single_run_leaves_the_folder_of_a_resolution(made: Made) -> None:
    out, _, inputs = made
    with pytest.raises(ConfigError, match="is the folder of one of several resolutions"):
        run_resolutions(inputs, out / "3m", settings())
    with pytest.raises(ConfigError, match=r"report\.html: already exists"):
        run_resolutions(inputs, out, settings())


def test_progress_is_that_of_one_job(cloud: Path, tmp_path: Path) -> None:
    records: list[Progress] = []
    run_resolutions(
        [str(cloud)],
        tmp_path / "out",
        settings(resolution="1,2"),
        ProgressRecords(records.append),
    )
    shares = [record["progress"] for record in records if record["progress"] is not None]
    assert shares == sorted(shares)
    assert [record["message"] for record in records].count("done") == 1
    assert records[-1]["message"] == "done"


def test_folders_that_were_moved_find_their_store(cloud: Path, tmp_path: Path) -> None:
    run_resolutions([str(cloud)], tmp_path / "out", settings(resolution="1,2"))
    moved = (tmp_path / "out").rename(tmp_path / "moved")
    assert clean(moved / "2m").store_bytes > 0


@pytest.mark.parametrize(
    "changes",
    [
        {"surface": "p10"},
        {"voids": "fill", "interpolation": "natural"},
        {"edits": "ground"},
        {"breaklines": "lines"},
    ],
    ids=str,
)
def test_heights_agree_with_all_settings_of_the_surface(
    cloud: Path, tmp_path: Path, changes: dict[str, str]
) -> None:
    with laspy.open(cloud) as source:
        (west, south), crs = source.header.mins[:2], source.header.parse_crs()
    box = [[west + x, south + y] for x, y in ((20, 20), (40, 20), (40, 40), (20, 40), (20, 20))]
    line = [[west + 5, south + 10, 99.0], [west + 50, south + 13, 101.0]]
    features = {
        "edits": {"type": "Polygon", "coordinates": [box]},
        "lines": {"type": "LineString", "coordinates": line},
    }
    drawn = {}
    for name, geometry in features.items():
        feature = {"type": "Feature", "properties": {"action": "ground"}, "geometry": geometry}
        named = {"type": "name", "properties": {"name": f"EPSG:{crs.to_epsg()}"}}
        content = {"type": "FeatureCollection", "crs": named, "features": [feature]}
        drawn[name] = tmp_path / f"{name}.geojson"
        drawn[name].write_text(json.dumps(content))
    values = {
        key: str(drawn.get(key if key == "edits" else value, value))
        for key, value in changes.items()
    }
    result = run_resolutions(
        [str(cloud)], tmp_path / "out", settings(resolution="1,3", **values)
    )
    fine, coarse = (Path(one.out, "dtm.tif") for one in (result, *result.others))
    assert_heights_agree(fine, coarse)


def test_a_delivery_does_not_name_folders_of_the_provider(made: Made, tmp_path: Path) -> None:
    out = made[0]
    assert main(["deliver", str(out / "3m"), "--to", str(tmp_path / "delivery")]) == 0
    for path in (tmp_path / "delivery").glob("*.*"):
        if path.suffix in (".html", ".json"):
            assert str(out.parent) not in path.read_text("utf-8")
