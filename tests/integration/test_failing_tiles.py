"""A tile that kills its worker is left out, with its cause and its hole; the rest is that of a run in peace."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio

from tests.integration import deadly
from tests.invariants.runs import do, dtm, output_digests, the_store
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.products import HOLE

SETTINGS = {"in_process": False, "workers": 2, "tile_size": "64", "products": "dtm,mask"}


@pytest.fixture
def deadly_cells(
    city: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, small_buckets: None
) -> list[list[int]]:
    """The buckets of a tile that will be deadly to its worker; the ingest is done."""
    do(city, tmp_path / "out", tile_size="64", until="filter")
    cells: list[list[int]] = max(the_store(tmp_path / "out").committed("filter0").items())[1][
        1
    ]["cells"]
    monkeypatch.setattr("tiler.filter.tasks.passes.filter_tile", deadly.deadly_tile)
    monkeypatch.setenv(deadly.CELL, f"{cells[0][0]},{cells[0][1]}")
    return cells


@pytest.mark.parametrize(
    ("deed", "cause", "settings"),
    [
        ("exit", "killed its worker 3 times: it crashed (exit code 1)", {}),
        pytest.param(
            "sleep", "it did not end within 5 s", {"task_seconds": 5}, marks=pytest.mark.slow
        ),
        pytest.param("allocate", "Unable to allocate 32.0 GiB", {}, marks=pytest.mark.slow),
    ],
)
def test_a_deadly_tile_leaves_a_hole_that_is_told(
    deed: str,
    cause: str,
    settings: dict[str, int],
    city: Path,
    tmp_path: Path,
    deadly_cells: list[list[int]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = tmp_path / "out"
    monkeypatch.setenv(deadly.DEED, deed)
    parameters = {"iteration_distance": "1.39"}
    result = do(city, out, parameters=parameters, **SETTINGS, **settings)
    assert result.exit_code == 5
    (failed,) = result.summary["failed_tasks"]
    assert failed["stage"] == "filter0"
    assert cause in failed["error"]
    lattice, cells = the_store(out).meta.bucket, np.array(deadly_cells)
    edges = map(int, (*cells.min(axis=0), *(cells.max(axis=0) + 1)))
    assert failed["bounds"] == [lattice.first(edge) / COUNTS_PER_UNIT for edge in edges]
    events = [json.loads(line) for line in (out / "events.jsonl").read_text().splitlines()]
    told = [
        e["event"]
        for e in events
        if e["event"].startswith("task_") and e["key"] == failed["key"]
    ]
    assert told[-3:] == ["task_again", "task_again", "task_failed"]
    west, south, east, north = failed["bounds"]
    before, after = laspy.read(city), laspy.read(out / "classified" / city.name)
    inside = (before.x >= west) & (before.x < east) & (before.y >= south) & (before.y < north)
    assert inside.sum() > 100
    assert np.array_equal(
        np.asarray(before.classification)[inside], np.asarray(after.classification)[inside]
    )
    assert (np.asarray(after.classification)[~inside] == 2).sum() > 1000
    assert (dtm(out)[0] != -9999).mean() > 0.5
    assert_hole_in_mask(out, failed["bounds"])
    # What was passing is gone: the same command ends in the bytes of a run in peace.
    monkeypatch.setenv(deadly.CELL, "0,0")
    assert (
        do(city, out, parameters=parameters, tile_size="64", products="dtm,mask").exit_code == 0
    )
    do(city, tmp_path / "peace", tile_size="64", products="dtm,mask", parameters=parameters)
    assert output_digests(out) == output_digests(tmp_path / "peace")


def assert_hole_in_mask(out: Path, bounds: list[float]) -> None:
    """All pixels of a place are holes, and hardly any others."""
    with rasterio.open(out / "mask.tif") as raster:
        mask, transform = raster.read(1), raster.transform
    y, x = np.mgrid[: mask.shape[0], : mask.shape[1]] + 0.5  # pixels of a metre
    x, y = transform.c + x, transform.f - y
    west, south, east, north = bounds
    inside = (x >= west) & (x < east) & (y >= south) & (y < north)
    assert inside.sum() > 500
    assert (mask[inside] == HOLE).all()
    assert (mask[~inside] == HOLE).mean() < 0.05


def test_buckets_that_fail_leave_a_hole_that_is_told(
    city: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, small_buckets: None
) -> None:
    out, settings = tmp_path / "out", {"tile_size": "64", "products": "dtm,mask"}
    do(city, tmp_path / "peace", **settings)
    groups = the_store(tmp_path / "peace").committed("assemble")
    key = max(groups, key=lambda k: sum(b["n"] for b in groups[k][1]["buckets"]))
    ix, iy = groups[key][1]["buckets"][0]["cell"]
    monkeypatch.setattr("tiler.ingest.tasks.points.assemble_buckets", deadly.failing_group)
    monkeypatch.setenv(deadly.CELL, f"{ix},{iy}")
    result = do(city, out, **settings)
    assert result.exit_code == 5
    (failed,) = result.summary["failed_tasks"]
    assert (failed["stage"], failed["key"]) == ("assemble", key)
    assert "this group fails" in failed["error"]
    assert_hole_in_mask(out, failed["bounds"])
    west, south, east, north = failed["bounds"]
    las = laspy.read(out / "classified" / city.name)
    inside = (las.x >= west) & (las.x < east) & (las.y >= south) & (las.y < north)
    classes = np.asarray(las.classification)
    assert (classes[inside] == 1).all(), "they keep the class that they came with"
    assert (classes[~inside] == 2).any()
    monkeypatch.setenv(deadly.CELL, "0,0")
    assert do(city, out, **settings).exit_code == 0
    assert output_digests(out) == output_digests(tmp_path / "peace")
