"""Tiled = untiled wherever nothing is marked, and the marks fall to zero as the halo grows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.invariants import clouds
from tests.invariants.clouds import SHAPES, Cloud
from tests.invariants.runs import do, stored_labels

UNTILED = "100000"
HALOS_M = (5, 20, 40, 80, 160)


@pytest.fixture(scope="module")
def shapes(city: Cloud, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("shapes")
    return {
        name: clouds.write(folder / f"{name}.laz", shape(city))
        for name, shape in SHAPES.items()
    }


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    "tile", [64, *(pytest.param(tile, marks=pytest.mark.slow) for tile in (32, 96))]
)
def test_tiles_do_not_show(
    shape: str, tile: int, shapes: dict[str, Path], tmp_path: Path
) -> None:
    do(shapes[shape], tmp_path / "whole", until="filter", tile_size=UNTILED)
    whole, doubt = stored_labels(tmp_path / "whole")
    assert not doubt.any()
    tiled_run = do(
        shapes[shape], tmp_path / "tiled", until="filter", tile_size=str(tile), halo=40
    )
    tiled, marked = stored_labels(tmp_path / "tiled")
    assert tiled_run.summary["filter"]["tiles"] > 3
    assert tiled_run.summary["filter"]["marked"] == int(marked.sum())
    assert np.array_equal(tiled[~marked], whole[~marked])
    assert not marked.any()


@pytest.mark.parametrize(
    "shape",
    [
        "river",
        *(pytest.param(shape, marks=pytest.mark.slow) for shape in ("full", "flight line")),
    ],
)
def test_marks_tell_the_truth_and_fall_to_zero(
    shape: str, shapes: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    do(shapes[shape], tmp_path / "whole", until="filter", tile_size=UNTILED)
    whole, _ = stored_labels(tmp_path / "whole")
    monkeypatch.setattr("tiler.plan.method.MAX_HALO_FACTOR", 1)
    marks, wrong = [], []
    for halo in HALOS_M:
        do(shapes[shape], tmp_path / "tiled", until="filter", tile_size="64", halo=halo)
        tiled, marked = stored_labels(tmp_path / "tiled")
        marks.append(int(marked.sum()))
        wrong.append(int((tiled != whole).sum()))
        assert np.array_equal(tiled[~marked], whole[~marked]), f"halo {halo} m"
    assert wrong[0] > 0, "so small a halo that the test sees nothing"
    assert marks[-1] == wrong[-1] == 0
    assert marks == sorted(marks, reverse=True)
