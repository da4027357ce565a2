"""Odd, broken and lying files through the command: the exit code and the line that people get, never a traceback."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import pytest

from cli.main import main
from tests.integration.command import assert_one_line

NO_CRS_FILES = """extra.laz gps-time-nan.las noise-dirty.las simple1_3.las test_noepsg_043500_629205_IGN69.laz
vegetation_1_3.las warsaw_small.las""".split()  # noqa: SIM905
REFUSED = {
    "1.2-no-points.las": "says 1065 points, has room for 0",
    "1.2-with-color-clipped.las": "says 1065 points, has room for 1064",
    "Semis_2022_0906_6665_nok.laz": "header was never finished",
    "epsg_4326.las": "geographic",
    "garbage_nVariableLength.las": "variable length records",
    "no-points.las": "no points to make a terrain from",
    "spurious.las": "geographic",
    **dict.fromkeys(NO_CRS_FILES, "has no CRS"),
}
READ = """1.0_0.las 4_6_crop.las bad_vlr_count.las file_with_both_wkt_and_geotiff_vlrs.las fullwave.laz
simple.copc.laz""".split()  # noqa: SIM905


@pytest.fixture(scope="module")
def odd(shared_data: Path) -> Path:
    if not (shared_data / "odd").is_dir():
        pytest.skip("no odd files: ../shared/data/odd is absent")
    return shared_data / "odd"


def test_each_file_is_in_the_table(odd: Path) -> None:
    assert {path.name for path in odd.iterdir()} == {*REFUSED, *READ}


def run(out: Path, *arguments: object) -> int:
    """The exit code of a run in this process, but for what reads files."""
    return main([str(a) for a in ("run", *arguments, "-o", out, "--in-process", "-q")])


@pytest.mark.slow
@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_line(
    name: str, odd: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path / "out", odd / name) == 3
    assert_one_line(capsys.readouterr().err, name, REFUSED[name])
    assert not (tmp_path / "out" / "dtm.tif").exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", [*READ, *NO_CRS_FILES])
def test_read_to_the_end(name: str, odd: Path, tmp_path: Path) -> None:
    crs = ("--crs", "none") if name in NO_CRS_FILES else ()
    assert run(tmp_path / "out", odd / name, *crs) == 0
    (written,) = (tmp_path / "out" / "classified").iterdir()
    with laspy.open(odd / name) as before, laspy.open(written) as after:
        assert after.header.point_count == before.header.point_count


def test_all_of_them_at_once_is_refused_for_the_degrees(
    odd: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path / "out", odd, "--crs", "none") == 3
    assert_one_line(capsys.readouterr().err, "geographic")


@pytest.mark.slow
@pytest.mark.parametrize("name", [*REFUSED, *READ])
def test_the_check_of_each_file_ends_in_rows_or_in_one_line(
    name: str, odd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main(["check", str(odd / name), "--json"])
    printed = capsys.readouterr()
    if name in REFUSED and name not in NO_CRS_FILES:
        assert code == 3
        assert_one_line(printed.err, name)
    else:
        assert code == 0
        rows = json.loads(printed.out)["rows"]
        assert all(row["found"] is not None or row["remark"] for row in rows)
