"""Another frame offset changes nothing; a shift by a common multiple of all lattice cells neither."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.invariants import clouds
from tests.invariants.clouds import CORNER, Cloud
from tests.invariants.runs import do, dtm, output_digests, stored_labels, the_store

ALL_CELLS_M = 640
"""A multiple of pixels, fine cells, thinning cells (1), seed cells (20), buckets (32), tiles
(64)."""


@pytest.mark.parametrize(
    "offset",
    [
        *(pytest.param(o, marks=pytest.mark.slow) for o in ((1, -1), (123_457, 987_643))),
        (-777_777_777, 999_999_937),
    ],
)
def test_the_frame_offset_is_in_no_result(
    offset: tuple[int, int],
    quarter_files: list[Path],
    finished: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    near = int(CORNER[0] * 1000), int(CORNER[1] * 1000)
    origin = near[0] + offset[0], near[1] + offset[1]
    monkeypatch.setattr("tiler.plan.sizes.origin_of", lambda extent: origin)
    do(quarter_files, tmp_path / "out")
    assert the_store(tmp_path / "out").meta.frame.origin == origin
    assert output_digests(tmp_path / "out") == output_digests(finished)


@pytest.mark.parametrize(
    "cells",
    [
        (-1562, -16875),
        *(pytest.param(cells, marks=pytest.mark.slow) for cells in ((1, 0), (-3, 7))),
    ],
)
def test_a_shift_by_whole_cells_only_moves_the_result(
    cells: tuple[int, int], city: Cloud, city_file: Path, tmp_path: Path
) -> None:
    east, north = (ALL_CELLS_M * i for i in cells)
    moved = clouds.write(
        tmp_path / "moved.laz", city, corner=(CORNER[0] + east, CORNER[1] + north)
    )
    do(city_file, tmp_path / "here")
    do(moved, tmp_path / "there")
    (here, from_here), (there, from_there) = dtm(tmp_path / "here"), dtm(tmp_path / "there")
    assert here.tobytes() == there.tobytes()
    assert (from_there.c - from_here.c, from_there.f - from_here.f) == (east, north)
    for mine, theirs in zip(
        stored_labels(tmp_path / "here"), stored_labels(tmp_path / "there"), strict=True
    ):
        assert np.array_equal(mine, theirs)
