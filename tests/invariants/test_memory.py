"""Measured peak memory <= projected <= allowed."""

from __future__ import annotations

import functools
import itertools
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.invariants import clouds
from tests.invariants.runs import do
from tiler.errors import ConfigError

MEASURED = """
import json, sys
from tests.invariants.runs import do
from pathlib import Path
do(Path(sys.argv[1]), Path(sys.argv[2]), water="auto", **json.loads(sys.argv[3]))
"""


@functools.cache
def compile_kernels(method: str) -> None:
    subprocess.run([sys.executable, "-m", "cli.main", "warm", method], check=True)


def measured_run(path: Path, out: Path, **changes: object) -> dict:
    """run.json of a serial run in a process of its own, with kernels that were compiled before."""
    compile_kernels(str(changes.get("method", "classic")))
    subprocess.run(
        [sys.executable, "-c", MEASURED, str(path), str(out), json.dumps(changes)], check=True
    )
    content: dict = json.loads((out / "run.json").read_text())
    return content


def repeated(cloud: clouds.Cloud, side_m: float, times: int) -> clouds.Cloud:
    """A square of the same cloud beside itself, so many times in each direction: to simulate all would take longer."""
    shifts = [
        (side_m * i, side_m * j, 0.0) for i, j in itertools.product(range(times), repeat=2)
    ]
    return clouds.Cloud(
        np.concatenate([cloud.xyz + shift for shift in shifts]),
        np.tile(cloud.truth, len(shifts)),
    )


def assert_within(content: dict) -> None:
    projected = content["plan"]["projected_memory_bytes"]
    assert max(projected.values()) <= content["plan"]["memory_bytes"]
    stages = content["stages"]
    assert stages["filter0"]["peak_rss_bytes"] <= max(projected["ingest"], projected["filter"])
    assert content["peak_rss_bytes"] <= max(projected.values())
    assert content["peak_rss_bytes"] > 50 << 20, "measured nothing"


@pytest.mark.processes
def test_a_small_run_stays_within_what_was_projected(city_file: Path, tmp_path: Path) -> None:
    assert_within(measured_run(city_file, tmp_path / "out"))


@pytest.mark.processes
@pytest.mark.slow
@pytest.mark.parametrize(("density", "tile"), [(4.0, "600"), (16.0, "256")])
def test_a_million_points_stay_within_what_was_projected(
    density: float, tile: str, tmp_path: Path
) -> None:
    side = (1e6 / density) ** 0.5
    path = clouds.write(
        tmp_path / "city.laz", repeated(clouds.city(side / 2, density, seed=4), side / 2, 2)
    )
    assert_within(measured_run(path, tmp_path / "out", tile_size=tile, halo=80, memory="2GiB"))


@pytest.mark.processes
@pytest.mark.slow
@pytest.mark.parametrize("tile", ["384", None])
def test_rasters_of_matched_clouds_stay_within_what_was_projected(
    tile: str | None, tmp_path: Path
) -> None:
    """A diagonal strip: the windows' rasters hold ten times as many cells as there are points elected."""
    cloud = repeated(clouds.city(250.0, 3.0, seed=5), 250.0, 3)
    strip = abs(cloud.xyz[:, 0] - cloud.xyz[:, 1]) < 30.0
    path = clouds.write(tmp_path / "strip.laz", cloud.take(strip))
    content = measured_run(
        path, tmp_path / "out", method="auto", kind="dim", tile_size=tile, memory="1GiB"
    )
    assert_within(content)
    peaks = {name: stage["peak_rss_bytes"] for name, stage in content["stages"].items()}
    filters = [peak for name, peak in peaks.items() if name.startswith("filter")]
    assert max(filters) <= content["plan"]["projected_memory_bytes"]["filter"]


@pytest.mark.parametrize("memory", ["1MiB", "300MiB"])
def test_a_run_that_would_need_more_is_refused_before_it_reads(
    memory: str, city_file: Path, tmp_path: Path
) -> None:
    with pytest.raises(
        ConfigError, match=r"needs .* MiB per worker, but .* MiB are allowed; use --memory"
    ):
        do(city_file, tmp_path / "out", memory=memory)
    assert not (tmp_path / "out").exists()


def test_the_tile_size_of_an_earlier_run_is_refused_with_less_memory(
    city_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tiler.plan.memory.VERTEX_BYTES", 60_000)
    do(city_file, tmp_path / "out", until="ingest", tile_size="512", memory="8GiB")
    settings = {"until": "ingest", "halo": "16"}
    with pytest.raises(ConfigError, match=r"filter needs .* MiB are allowed") as refused:
        do(city_file, tmp_path / "out", tile_size=None, memory="1500MiB", **settings)
    memory, tile = re.findall(
        r"use --memory (\d+MiB) or --tile-size (\d+)$", str(refused.value)
    )[0]
    for values in (
        {"memory": memory, "tile_size": None},
        {"memory": "1500MiB", "tile_size": tile},
    ):
        assert do(city_file, tmp_path / "out", **settings, **values).exit_code == 0, (
            "what is named suffices"
        )
