"""Input order and file split change nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.invariants import clouds
from tests.invariants.clouds import Cloud
from tests.invariants.runs import assert_same_terrain, classes_by_point, do, output_digests


def assert_same(out: Path, other: Path) -> None:
    """The same terrain, and the same class for each point."""
    assert_same_terrain(out, other)
    assert np.array_equal(classes_by_point(out), classes_by_point(other))


def test_order_of_the_names_changes_no_byte(
    quarter_files: list[Path], finished: Path, tmp_path: Path
) -> None:
    do(quarter_files[::-1], tmp_path / "out")
    assert output_digests(tmp_path / "out") == output_digests(finished)


def test_one_file_or_four(city_file: Path, finished: Path, tmp_path: Path) -> None:
    do(city_file, tmp_path / "out")
    assert_same(tmp_path / "out", finished)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_shuffled_points_in_files_without_sense(
    city: Cloud, finished: Path, tmp_path: Path, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(city))
    parts = np.array_split(order, 3)
    paths = [
        clouds.write(tmp_path / f"{i}.laz", city.take(part)) for i, part in enumerate(parts)
    ]
    do(paths, tmp_path / "out")
    assert_same(tmp_path / "out", finished)


def test_pieces_of_a_file_change_nothing(
    city: Cloud, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Of LAS: pieces of LAZ are whole chunks of 50,000.
    monkeypatch.setattr("tiler.ingest.tasks.points.PIECE_POINTS", 5_000)
    result = do(clouds.write(tmp_path / "city.las", city), tmp_path / "out")
    assert result.summary["stages"]["spool"]["tasks"] > 1
    assert_same(tmp_path / "out", finished)
