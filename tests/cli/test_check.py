"""`tiler check` from the command line: figures, JSON, exit codes."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import laspy
import numpy as np
import pytest

from cli.commands.check import command
from cli.help import options_in
from cli.main import main
from tests.tiler.apps.acceptance.pulses import Pulses, lattice
from tests.tiler.apps.check.rasters import tilted, write_surface
from tests.tiler.report import results
from tiler.errors import InputError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A tilted plane, and 32 checkpoints that lie 0.05 below it."""
    write_surface(tmp_path / "dtm.tif", tilted)
    x, y = np.random.default_rng(4).uniform(1, 39, (2, 32))
    lines = [
        f"{a},{b},{c - 0.05},NVA,field" for a, b, c in zip(x, y, tilted(x, y), strict=True)
    ]
    (tmp_path / "points.csv").write_text("x,y,z,type,cover\n" + "\n".join(lines))
    return tmp_path


def test_an_empty_folder_is_refused_with_all_that_may_be_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(tmp_path)]) == InputError.exit_code
    remedy = "give a raster, or a folder with clouds or the results of a run"
    line = f"{tmp_path}: cannot be read (the folder is not a raster); {remedy}"
    assert capsys.readouterr().err.strip().endswith(line)


def test_a_report_for_people(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = [
        "--points",
        str(folder / "points.csv"),
        "--points-rmse",
        "1cm",
        "--tile-size",
        "10",
        "--require",
        "mean=4cm",
    ]
    assert main(["check", str(folder / "dtm.tif"), *options]) == 5
    out = capsys.readouterr().out.splitlines()
    assert out[0] == "DTM minus checkpoint, metre"
    assert out[2].split() == [
        "NVA",
        "32",
        "0.051",
        "+0.050",
        "+0.050",
        "0.000",
        "0.050",
        "0.050",
        "0",
    ]
    assert out[4].split()[0] == "field"
    assert "RMSEV = 5.1 cm with 32 checkpoints" in out[5]
    assert "steps between pixels, metre, across edges of tiles of 10 m" in out
    assert any(line.startswith("  tiles ") for line in out)
    assert any("NOT met" in line for line in out)


@pytest.mark.parametrize(
    ("step", "begin"),
    [
        (0.0, "No seam: steps at tile edges are "),
        (
            0.3,
            "Seams: steps at tile edges are larger by 0.2998 metre than next to them (mean jump 0.3000 metre",
        ),
    ],
)
def test_a_sentence_says_whether_there_are_seams(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], step: float, begin: str
) -> None:
    noise = np.random.default_rng(1).normal(0, 0.0001, (120, 120))
    write_surface(
        tmp_path / "dtm.tif", lambda x, y: noise + step * ((x > 60) ^ (y > 60)), side=120
    )
    assert main(["check", str(tmp_path / "dtm.tif"), "--tile-size", "60"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith(begin)


def test_a_requirement_that_fails_ends_with_5(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["check", str(folder / "dtm.tif"), "--points", str(folder / "points.csv")]
    arguments += ["--require", "rmse=0.06"]
    assert main(arguments) == 0
    assert "NOT met" not in capsys.readouterr().out
    assert (
        main([*arguments, "--require", "mean=4cm", "--json", "--figures", str(folder / "f")])
        == 5
    )
    report = json.loads(capsys.readouterr().out)
    assert [r["met"] for r in report["requirements"]] == [True, False]
    assert report["accuracy"]["nva"]["rmse"] == pytest.approx(0.05, abs=1e-4)
    assert [Path(path).name for path in report["figures"]] == ["histogram.svg", "map.svg"]


def test_check_of_a_result_folder_writes_its_check_and_its_page(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = results.write(folder / "out", results.run(outputs={}))
    points = [
        "--points",
        str(folder / "points.csv"),
        "--points-rmse",
        "1cm",
        "--tile-size",
        "10",
        "--require",
        "mean=4cm",
    ]
    assert main(["check", str(out), *points]) == 3
    assert "contains no DTM; finish its run" in capsys.readouterr().err
    assert not (out / "check.json").exists()
    write_surface(out / "dtm.tif", tilted)
    assert main(["check", str(out), *points]) == 5
    assert capsys.readouterr().out.splitlines()[-1] == f"report  {out / 'report.html'}"
    check = json.loads((out / "check.json").read_text())
    assert check["requirements"][0]["met"] is False
    page = results.read(out / "report.html")
    assert "Finished, but 1 requirement is not met" in page.texts[""]
    assert "measured mean = 0.05 m; the limit is 0.04 m" in page.texts["problems"]
    assert "RMSEV = 5.1 cm with 32 checkpoints" in page.texts["accuracy"]
    assert len(page.data["checkpoints"]) == 32
    # Another check keeps what it does not measure, and limits.
    assert main(["check", str(out), "--tile-size", "20", "--require", "seam=1"]) == 0
    later = json.loads((out / "check.json").read_text())
    assert later["accuracy"] == check["accuracy"]
    assert later["seams"] != check["seams"]
    assert [r["name"] for r in later["requirements"]] == ["mean", "seam"]
    assert later["requirements"][0] == check["requirements"][0]
    # A limit is judged by the latest measurement.
    assert main(["check", str(out), "--tile-size", "10", "--require", "seam=2"]) == 0
    (first, second) = json.loads((out / "check.json").read_text())["requirements"]
    assert (first, second["limit"]) == (check["requirements"][0], 2.0)
    # Another terrain was not measured.
    write_surface(out / "dtm.tif", tilted)
    os.utime(out / "dtm.tif", (time.time() + 60,) * 2)
    assert main(["check", str(out), "--tile-size", "10"]) == 0
    assert "accuracy" not in json.loads((out / "check.json").read_text())
    # If a DTM is given, the result is only printed.
    (out / "check.json").unlink()
    capsys.readouterr()
    assert main(["check", str(out / "dtm.tif"), *points, "--json"]) == 5
    assert json.loads(capsys.readouterr().out)["requirements"] == check["requirements"]
    assert not (out / "check.json").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "nothing to check; give --points"),
        (["--figures", "f"], "--figures draws checkpoints"),
        (["--tile-size", "10", "--require", "rmse=1"], "is not measured without --points"),
        (["--tile-size", "-1"], "not a length"),
    ],
)
def test_what_is_refused(
    folder: Path, arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(folder / "dtm.tif"), *arguments]) == 2
    assert message in capsys.readouterr().err


def test_a_constant_offset_is_shown_instead_of_a_statement(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = results.write(folder / "out", results.run(outputs={}))
    write_surface(out / "dtm.tif", lambda x, y: tilted(x, y) - 49.25)
    points = ["--points", str(folder / "points.csv"), "--points-rmse", "1cm"]
    assert main(["check", str(out), *points, "--tile-size", "10"]) == 0
    printed = capsys.readouterr().out
    sentence = (
        "constant offset of -49.2 m (median; NMAD 0.000): another vertical datum or unit?"
    )
    assert sentence in printed
    lacks = "no accuracy statement by the ASPRS standards: the heights have a constant offset"
    assert lacks in printed
    accuracy = json.loads((out / "check.json").read_text())["accuracy"]
    assert accuracy["constant_offset"].startswith(sentence)
    assert accuracy["asprs"]["statement"] is None
    page = results.read(out / "report.html").texts["accuracy"]
    assert f"C{sentence[1:]}" in page
    assert f"N{lacks[1:]}" in page


def test_swapped_axes_are_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_surface(folder / "far.tif", tilted, west=500_000, south=5_300_000)
    (folder / "swapped.csv").write_text("x,y,z\n5300010,500010,101\n5300020,500020,102\n")
    arguments = ["check", str(folder / "far.tif"), "--points", str(folder / "swapped.csv")]
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert (
        "none of the checkpoints (2) is inside the DTM, but 2 would be with x and y swapped"
        in printed.err
    )


def cloud_of(folder: Path) -> Path:
    return Pulses(*lattice(0, 30, 0, 30)).write(folder / "a.laz")


def test_clouds_are_compared_with_a_specification(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = cloud_of(tmp_path)
    assert main(["check", str(path)]) == 0
    assert capsys.readouterr().out.startswith("1 cloud, 3,600 points, cells of ")
    asked = tmp_path / "asked.toml"
    asked.write_text("pulse_density = 4\nduplicates = 0\n")
    assert main(["check", str(tmp_path), "--spec", str(asked)]) == 0
    out = capsys.readouterr().out.splitlines()
    assert ["pulse", "density", "at", "least", "4", "per", "m2", "4", "per", "m2", "pass"] in [
        line.split() for line in out
    ]
    assert out[-1] == f"met: all 2 rows of {asked}"
    asked.write_text("pulse_density = 5\nduplicates = 0\n")
    assert main(["check", str(path), "--spec", str(asked)]) == 5
    assert capsys.readouterr().out.splitlines()[-1] == (
        f"NOT met: 1 of 2 rows of {asked} (pulse density)"
    )
    assert main(["check", str(path), "--spec", str(asked), "--json"]) == 5
    report = json.loads(capsys.readouterr().out)
    states = {row["name"]: row["state"] for row in report["rows"]}
    assert (states["pulse_density"], states["duplicates"], states["voids"]) == (
        "fail",
        "pass",
        "not asked",
    )


def test_the_page_of_a_check_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "check.html"
    assert main(["check", str(cloud_of(tmp_path)), "--page", str(target)]) == 0
    assert f"wrote   {target}" in capsys.readouterr().out.splitlines()
    assert "3,600 points" in results.read(target).texts[""]


def test_differences_of_swaths_are_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    both = Pulses(*lattice(0, 40, 0, 30), 1) + Pulses(*lattice(20, 60, 0, 30), 2)
    target = tmp_path / "swaths.tif"
    arguments = ["check", str(both.write(tmp_path / "a.laz")), "--difference", str(target)]
    assert main(arguments) == 0
    out = capsys.readouterr().out.splitlines()
    for path in (target, target.with_suffix(".qml")):
        assert f"wrote   {path}" in out
    assert any(line.startswith("swath step: 1 pair; point source 2 - 1: ") for line in out)
    assert target.is_file()


def test_options_of_the_other_kind_of_input_are_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cloud = str(cloud_of(tmp_path))
    assert main(["check", cloud, "--tile-size", "10"]) == 2
    assert "--tile-size: is for a DTM, " in capsys.readouterr().err
    assert main(["check", str(folder / "dtm.tif"), "--spec", "usgs-ql2"]) == 2
    assert "--spec usgs-ql2: is for clouds, " in capsys.readouterr().err
    assert main(["check", str(folder / "dtm.tif"), "--page", "check.html"]) == 2
    assert "--page check.html: is for clouds, " in capsys.readouterr().err
    assert main(["check", cloud, str(folder / "dtm.tif")]) == 2
    error = capsys.readouterr().err
    assert "dtm.tif: is not a cloud; give one DTM" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("fault", ["cut", "unfinished", "degrees"])
def test_remedies_for_clouds_name_only_options_of_the_check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], fault: str
) -> None:
    own = {name for p in command.params for name in (*p.opts, *p.secondary_opts)}
    pulses = Pulses(*lattice(0, 20, 0, 20))
    path = tmp_path / "a.las"
    if fault == "degrees":
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.scales, header.offsets = np.full(3, 1e-7), np.zeros(3)
        las = laspy.LasData(header)
        las.x, las.y, las.z = 8 + pulses.x * 1e-5, 47 + pulses.y * 1e-5, pulses.z
        las.write(path)
    else:
        raw = bytearray(pulses.write(path).read_bytes())
        if fault == "unfinished":
            raw[94:100] = bytes(6)  # size of the header, and the start of the points
        path.write_bytes(raw if fault == "unfinished" else raw[:-1000])
    assert main(["check", str(path)]) == 3
    error = capsys.readouterr().err
    assert "; " in error
    assert options_in(error) <= own
