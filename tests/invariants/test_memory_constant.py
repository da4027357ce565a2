"""Peak memory does not grow with the number of points: not that of a worker, nor that of the command."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from tiler.schedule.worker import KEPT_SHARE

SIDE_M = 500
COPIES = 2
"""A side: the same city beside itself."""
MAX_X, MIN_X, OFFSET_X = 179, 187, 155
"""Bytes of a LAS header; those of y follow 8 bytes after the offset, 16 after the bounds."""

RUN = """
import json, sys
from tiler.config import RunConfig
from tiler.schedule.worker import peak_rss_bytes
from tiler.pipeline import run
config = RunConfig.from_mapping({"workers": 1, "method": "classic", "resolution": "1", "memory": "512MiB"})
summary = run([sys.argv[1]], sys.argv[2], config).summary
print(json.dumps({"command": peak_rss_bytes(), "points": summary["counts"]["stored"], "plan": summary["plan"],
                  **{name: stage["peak_rss_bytes"] for name, stage in summary["stages"].items()}}))
"""


def peaks(folder: Path) -> dict:
    """What a run on the clouds of a folder took, in a process of its own."""
    command = [
        sys.executable,
        "-c",
        RUN,
        str(folder),
        str(folder.parent / f"out_{folder.name}"),
    ]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    found: dict = json.loads(done.stdout)
    return found


def shifted(las: bytes, east: float, north: float) -> bytes:
    """A LAS file elsewhere, by its header alone."""
    moved = bytearray(las)
    for x, to_y in ((OFFSET_X, 8), (MAX_X, 16), (MIN_X, 16)):
        for place, by in ((x, east), (x + to_y, north)):
            struct.pack_into("<d", moved, place, struct.unpack_from("<d", moved, place)[0] + by)
    return bytes(moved)


@pytest.mark.processes
@pytest.mark.slow
def test_four_times_the_points_take_no_more_memory(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-m", "cli.main", "warm", "classic"], check=True)
    one, many = tmp_path / "one", tmp_path / "many"
    make = [
        sys.executable,
        "-m",
        "cli.main",
        "simulate",
        str(one / "city.las"),
        "--size",
        str(SIDE_M),
        "-q",
    ]
    subprocess.run(make, check=True)
    (one / "city_dtm.tif").unlink()
    many.mkdir()
    cloud = (one / "city.las").read_bytes()
    for number in range(COPIES**2):
        east, north = SIDE_M * (number % COPIES), SIDE_M * (number // COPIES)
        (many / f"{number}.las").write_bytes(shifted(cloud, east, north))
    small, large = peaks(one), peaks(many)
    assert large["points"] > 3.9 * small["points"] > 4_000_000
    # One city hardly fills a window of the grid, nor a picture of the report; and no tile of
    # the filter, as these are as large as the memory allows: of them what was projected is held
    # against it, below. What a worker keeps of such a tile, for its next task, comes on top.
    # All bounds are below 16 bytes for each point more.
    projected, allowed = large["plan"]["projected_memory_bytes"], large["plan"]["memory_bytes"]
    for what in ("spool", "assemble", "grid-dtm", "export"):
        assert large[what] <= 1.1 * small[what] + allowed / KEPT_SHARE, what
    assert large["command"] <= small["command"] + (32 << 20)
    assert max(projected.values()) <= allowed
    stages = {
        "spool": "ingest",
        "assemble": "ingest",
        "filter0": "filter",
        "grid-dtm": "grid",
        "export": "export",
    }
    for what, stage in stages.items():
        assert large[what] <= projected[stage], what
