"""Damaged files that are read as far as they are whole: what is lost is counted, warned of and in the exit code."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import laspy
import numpy as np
import pytest
from pyproj import CRS

from cli.main import main

N, CHUNK = 120_000, 50_000
LEGACY_COUNT, COUNT = 107, 247
"""Places of the numbers of points in the header of LAS 1.4."""


def cloud(path: Path) -> Path:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.array([500_000.0, 5_000_000.0, 0.0])
    header.add_crs(CRS(32632))
    file, rng = laspy.LasData(header), np.random.default_rng(3)
    x, y = rng.uniform(0, 120, (2, N))
    file.x, file.y, file.z = x + 500_000, y + 5_000_000, 100 + x / 20
    file.intensity = rng.integers(0, 65535, N)
    file.gps_time = rng.uniform(0, 1e5, N)
    file.write(path)
    return path


def cut(path: Path) -> Path:
    """The file without the last 30 % of its bytes: one whole chunk of three if it is a LAZ file."""
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 7 // 10])
    return path


@pytest.mark.parametrize("command", ["run", "classify"])
@pytest.mark.parametrize("suffix", ["laz", "las"])
def test_the_loss_is_warned_of_and_in_the_exit_code(
    suffix: str, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = cut(cloud(tmp_path / f"t.{suffix}"))
    with laspy.open(path) as file:
        rest = path.stat().st_size - file.header.offset_to_point_data
        n_read = CHUNK if suffix == "laz" else rest // file.header.point_format.size
    line = (
        f"{path}: {n_read:,} of {N:,} points could be read; get the file again to have them all"
    )
    out = tmp_path / "out.laz" if command == "classify" else tmp_path / "out"
    where = (out,)
    if command == "run":
        where = ("-o", out, "--classified", "none", "--in-process")
    given = [command, path, *where, "--salvage", "-q", "--method", "classic"]
    for _ in range(
        2 if command == "run" else 1
    ):  # A run that has nothing to do says it as well.
        assert main([str(text) for text in given]) == 5
        assert f"warning: {line}" in capsys.readouterr().err.splitlines()
    if command == "classify":
        with laspy.open(out) as file:
            assert file.header.point_count == n_read
        return
    run = json.loads((out / "run.json").read_text())
    assert run["exit_code"] == 5
    assert run["warnings"] == [line]
    assert [problem["why"] for problem in run["problems"]] == [line]
    (source,) = run["inputs"]
    assert (source["points"], source["stated_points"]) == (n_read, N)
    assert source["incomplete"] is True
    assert run["counts"]["read"] == n_read
    page = (out / "report.html").read_text()
    assert "Left out: 1 part of a file" in page
    assert "Nothing was left out" not in page


def test_points_that_the_header_does_not_count_are_told_and_can_be_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = cloud(tmp_path / "t.las"), tmp_path / "out"
    content = bytearray(path.read_bytes())
    struct.pack_into("<I", content, LEGACY_COUNT, N - 7)
    struct.pack_into("<Q", content, COUNT, N - 7)
    path.write_bytes(content)
    given = [str(text) for text in ("run", path, "-o", out, "--in-process", "-q")]
    assert main(given) == 5
    line = f"{path}: 7 records behind the {N - 7:,} points of its header look like points"
    assert (
        f"warning: {line} and were not read; use --salvage to read them"
        in capsys.readouterr().err
    )
    run = json.loads((out / "run.json").read_text())
    assert run["counts"]["read"] == N - 7
    assert line in run["problems"][0]["why"]
    assert main([*given, "--salvage"]) == 0
    run = json.loads((out / "run.json").read_text())
    assert (run["counts"]["read"], run["problems"]) == (N, [])


def test_a_header_that_states_no_points_is_said_to_state_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = cloud(tmp_path / "t.las")
    content = bytearray(path.read_bytes())
    struct.pack_into("<I", content, LEGACY_COUNT, 0)
    struct.pack_into("<Q", content, COUNT, 0)
    path.write_bytes(content)
    assert main(["plan", str(path), "--salvage"]) == 0
    assert f"{N:,} of an unknown number of points could be read" in " ".join(
        capsys.readouterr().out.split()
    )


def test_a_damaged_table_without_lost_points_is_no_loss(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = cloud(tmp_path / "t.laz")
    with laspy.open(path) as file:
        points_offset = file.header.offset_to_point_data
    content = bytearray(path.read_bytes())
    struct.pack_into("<q", content, points_offset, 10 * len(content))
    path.write_bytes(content)
    out = tmp_path / "out"
    given = ("run", path, "-o", out, "--salvage", "--in-process", "--method", "classic", "-q")
    assert main([str(text) for text in (*given, "--classified", "none")]) == 0
    assert "could be read" not in capsys.readouterr().err
    (source,) = json.loads((out / "run.json").read_text())["inputs"]
    assert (source["points"], source["salvaged"], source["incomplete"]) == (N, True, False)
