"""What is far away changes nothing of a place; what is near a part of a run is known from the run on everything."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.invariants import clouds
from tests.invariants.clouds import Cloud
from tests.invariants.runs import classes_by_point, computed, do, stored_labels
from tiler.errors import ConfigError
from tiler.pipeline import RunResult


@pytest.mark.parametrize("kind", ["als", "dim"])
def test_a_file_far_away_is_done_alone(kind: str, tmp_path: Path) -> None:
    def run(*paths: Path) -> RunResult:
        return do(
            [*paths],
            tmp_path / "out",
            "filter",
            method="auto",
            halo=None,
            tile_size=512,
            kind=kind,
        )

    city, other = clouds.city(60.0, 4.0), clouds.city(60.0, 1.0, seed=2)
    near = clouds.write(tmp_path / "a.laz", city)
    far = clouds.write(tmp_path / "b.laz", Cloud(other.xyz + (7600.0, 0.0, 0.0), other.truth))
    first = computed(run(near))
    alone, _ = stored_labels(tmp_path / "out")
    second = computed(run(near, far))
    both, _ = stored_labels(tmp_path / "out")
    filters = [name for name in second if name.startswith("filter")]
    assert len(filters) > 4
    assert {first[name] for name in filters} == {second[name] for name in filters} == {1}
    assert np.array_equal(both[: len(alone)], alone)


def test_a_part_has_the_figures_of_places_of_the_run_on_everything(tmp_path: Path) -> None:
    """6 points/m2, and to the east, across the border of two places, 0.7: the part is to the east alone."""
    west, east = clouds.city(90.0, 6.0), clouds.city(90.0, 0.7, seed=2)
    parts = [
        Cloud(west.xyz + (130.0, 0, 0), west.truth),
        Cloud(east.xyz + (220.0, 0, 0), east.truth),
    ]
    files = [clouds.write(tmp_path / f"{k}.laz", part) for k, part in enumerate(parts)]
    how = {"method": "auto", "halo": None, "tile_size": 512, "kind": "als", "products": "dtm"}
    whole = do(files, tmp_path / "whole", **how)
    places = whole.summary["statistics"]["survey"]["places"]
    assert len({figures[0] for figures in places.values()}) > 2
    assert not any(
        "places" in state
        for name, state in whole.summary["statistics"].items()
        if name != "survey"
    )
    bounds = ("500240", "5400000", "500320", "5400090")
    known = do(
        files, tmp_path / "part", bounds=bounds, statistics=str(tmp_path / "whole"), **how
    )
    assert known.summary["statistics"] == whole.summary["statistics"]
    # Millimetres from the corner.
    labels = [classes_by_point(tmp_path / name) for name in ("part", "whole")]
    inner = [rows[(rows[:, 0] >= 240_000) & (rows[:, 0] < 320_000)] for rows in labels]
    assert len(inner[0]) > 3000
    assert np.array_equal(*inner)

    run_file = tmp_path / "whole" / "run.json"
    run = json.loads(run_file.read_text())
    del run["statistics"]["survey"]["places"]
    run_file.write_text(json.dumps(run))
    with pytest.raises(ConfigError, match="which did not measure density and noise"):
        do(files[1], tmp_path / "old", statistics=str(tmp_path / "whole"), **how)
