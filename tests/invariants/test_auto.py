"""The default method in whole runs: tiles, files, the order of points and the frame change no label."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from tests.invariants import clouds
from tests.invariants.clouds import CORNER, SHAPES, Cloud
from tests.invariants.runs import classes_by_point, do, stored_labels


@pytest.mark.parametrize(
    "shape",
    ["islands", *(pytest.param(shape, marks=pytest.mark.slow) for shape in ("full", "river"))],
)
def test_nothing_of_a_run_shows(
    shape: str, city: Cloud, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cloud = SHAPES[shape](city)
    whole = do(
        clouds.write(tmp_path / "a.laz", cloud),
        tmp_path / "whole",
        method="auto",
        halo=None,
        tile_size=512,
    )
    assert whole.summary["filter"]["marked"] == 0
    order = np.random.default_rng(0).permutation(len(cloud))
    files = [
        clouds.write(tmp_path / f"{i}.laz", cloud.take(p))
        for i, p in enumerate(np.array_split(order, 2))
    ]
    origin = int(CORNER[0] * 1000) - 123_457, int(CORNER[1] * 1000) + 77
    monkeypatch.setattr("tiler.plan.sizes.origin_of", lambda extent: origin)
    tiled = do(files, tmp_path / "tiled", method="auto", halo=None, tile_size=48)
    assert tiled.summary["filter"]["tiles"] > 5
    assert tiled.summary["filter"]["marked"] == 0
    assert not stored_labels(tmp_path / "tiled")[1].any()
    assert np.array_equal(
        classes_by_point(tmp_path / "tiled"), classes_by_point(tmp_path / "whole")
    )
    assert tiled.summary["statistics"] == whole.summary["statistics"]


def test_what_was_decided_is_told_and_a_narrow_halo_too(
    city_file: Path, tmp_path: Path
) -> None:
    result = do(city_file, tmp_path / "out", "filter", method="auto", halo="5", tile_size=96)
    notes = [*result.summary["statistics"]["survey"]["notes"], *result.summary["plan"]["notes"]]
    assert any(note.startswith("decided: laser scanning") for note in notes)
    assert any("summits 32 m, refine 62 m, roofs 229 m, roofs2 229 m" in note for note in notes)


def test_lengths_are_printed_in_feet_for_a_cloud_in_feet(city: Cloud, tmp_path: Path) -> None:
    in_feet = clouds.write(tmp_path / "a.laz", Cloud(city.xyz / 0.3048, city.truth))
    run = do(
        in_feet,
        tmp_path / "out",
        "filter",
        method="auto",
        units="ft",
        halo="300ft",
        tile_size="200ft",
        resolution="3ft",
    )
    assert "noise 0.0" in " ".join(run.notes)
    for text in (*run.notes, *run.warnings):
        assert not re.search(r"(?<![\w.(])[\d.]+ m\b", text), text
