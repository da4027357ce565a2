"""Nothing that a file says of itself, nor its name, reaches a terminal, a log or a report as a control sequence."""

from __future__ import annotations

import json
import re
import shutil
import unicodedata
from pathlib import Path

import laspy
import numpy as np
import pytest
from laspy.vlrs.known import WktCoordinateSystemVlr
from pyproj import CRS

from cli import commands
from cli.main import main
from tests.invariants import clouds

EVIL = "\x1b]0;gotcha\x07\x1b[31mred\x9b2J\u202egnp"
"""Sets a title, colours, clears the screen (in one byte of Latin-1 as well), and turns a name
around."""
NAME = f"town{EVIL}.laz".replace("/", "")
OPTIONS = ("--method", "classic", "--in-process", "--resolution", "1")


def assert_harmless(text: str) -> None:
    bad = {
        c for c in text if unicodedata.category(c) in ("Cc", "Cf", "Cs") and c not in "\n\r\t"
    }
    assert not bad, bad


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cloud with such a name, and a CRS that is called so too."""
    folder = tmp_path_factory.mktemp("evil")
    las = laspy.read(clouds.write(folder / "plain.laz", clouds.city(60.0)))
    wkt = (
        CRS.from_epsg(32632)
        .to_wkt("WKT1_GDAL")
        .replace("WGS 84 / UTM zone 32N", f"zone {EVIL}")
    )
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = las.header.scales, las.header.offsets
    header.vlrs.append(WktCoordinateSystemVlr(wkt))
    header.global_encoding.wkt = True
    evil = laspy.LasData(header)
    evil.x, evil.y, evil.z = las.x, las.y, las.z
    evil.classification = np.asarray(las.classification)
    evil.write(folder / NAME)
    return folder / NAME


@pytest.fixture(scope="module")
def out(cloud: Path) -> Path:
    folder = cloud.parent / f"out{EVIL}"
    assert main(["run", str(cloud), "-o", str(folder), *OPTIONS, "-q"]) == 0
    return folder


@pytest.mark.slow
def test_no_command_gives_control_characters_on(
    cloud: Path, out: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    points = tmp_path / f"points{EVIL}.csv"
    points.write_text(f"id,x,y,z,cover\np{EVIL},500030,5400030,100,c{EVIL}\n")
    figures = tmp_path / f"figures{EVIL}"
    broken = tmp_path / NAME
    broken.write_bytes(b"LASF")
    places = (cloud, out, out / "dtm.tif", out / "store.zarr", broken, tmp_path / f"gone{EVIL}")
    for arguments in (
        *(("info", place) for place in places),
        ("plan", cloud, *OPTIONS),
        ("plan", broken, cloud, *OPTIONS),
        ("run", cloud, "-o", out, *OPTIONS, "-vv"),
        ("check", out / "dtm.tif", "--points", points, "--figures", figures),
        ("check", out / "dtm.tif", "--strips", cloud),
        ("evaluate", out / "classified" / NAME, "--reference", cloud),
        ("evaluate", "--dtm", out / "dtm.tif", "--true-dtm", out / "dtm.tif"),
        ("report", out),
        ("clean", out),
        ("config", "--store", f"/data/{EVIL}"),
        ("config", "--aoi", EVIL, "--template"),
        ("methods", EVIL),
        (EVIL,),
        ("run", f"--{EVIL}"),
    ):
        main([str(a) for a in arguments])
        told = capfd.readouterr()
        assert told.out or told.err
        assert_harmless(told.out + told.err)
        if arguments[0] in ("info", "plan", "check", "evaluate"):
            main([*(str(a) for a in arguments), "--json"])
            told = capfd.readouterr()
            assert_harmless(told.out + told.err)
            if told.out:
                json.loads(told.out)
    for path in (
        *figures.iterdir(),
        out / "report.html",
        out / "run.json",
        out / "events.jsonl",
    ):
        assert_harmless(path.read_text("utf-8"))
    shutil.rmtree(out)


def test_tables_of_a_terminal_as_well(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from cli.output import print_table

    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    print_table(EVIL, ("a", "b"), [(EVIL, f"{EVIL}[bold]")])
    # rich's own colours
    assert_harmless(re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out))


def test_there_is_one_way_out_for_text() -> None:
    """What a command says goes through `cli.output`; click's own functions print what they are given."""
    folder = Path(str(commands.__file__)).parents[1]
    found = {
        p.name
        for p in folder.rglob("*.py")
        if re.search(r"\b(click\.s?echo|print)\(", p.read_text())
    }
    assert found <= {"output.py", "main.py"}
    calls = re.findall(r"click\.echo\(.*", (folder / "main.py").read_text())
    assert calls == ["click.echo(context.get_help(), err=True)"]
