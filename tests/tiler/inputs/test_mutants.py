"""Every mutant of every fixture is read correctly or refused in one line, without hanging or much memory."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from tests.scenes.laz_chunks import variable_chunks
from tests.tiler.inputs.mutants import Mutant, Reading, check, mutants, read_whole
from tiler.errors import InputError
from tiler.schedule import ChildDiedError, ChildProcess

SECONDS = 30.0
LARGEST = 110_000
"""Largest real files that are mutated; in larger ones, mutations would seldom hit interesting
bytes."""

FIXTURES: dict[str, dict[str, Any]] = {
    "plain.las": {"n": 200, "point_format": 3},
    "records.las": {
        "n": 50,
        "point_format": 6,
        "version": "1.4",
        "evlr": b"extended" * 20,
        "extra": True,
    },
    "points.laz": {"n": 900, "point_format": 1},
    "layers.laz": {
        "n": 900,
        "point_format": 7,
        "version": "1.4",
        "extra": True,
        "evlr": b"extended",
    },
    "waves.laz": {"n": 60, "point_format": 10, "version": "1.4"},
    "empty.laz": {"n": 0, "point_format": 6, "version": "1.4"},
    "octree.laz": {"n": 600, "point_format": 6, "version": "1.4"},
}


@pytest.fixture(scope="module")
def guard() -> Iterator[ChildProcess]:
    with ChildProcess() as guard:
        yield guard


def fixture(name: str, make_cloud: Any) -> Path:
    path: Path = make_cloud(name, **FIXTURES[name])
    if name == "octree.laz":
        records = np.asarray(laspy.read(path).points.array).copy()
        variable_chunks(path, [10, 300, 1, 289], records, 6)
    return path


def outcome(guard: ChildProcess, path: Path, salvage: bool) -> Reading | InputError:
    try:
        return guard.call(read_whole, path, salvage, seconds=SECONDS)
    except InputError as error:
        return error
    except ChildDiedError as died:  # what `inspect_in_child` makes of it
        return InputError(f"{path}: the process that reads it {died}; get the file again")


def hunt(
    guard: ChildProcess, original: bytes, path: Path, found: Iterator[Mutant]
) -> Counter[str]:
    """Read mutants of a file; count how many were read, refused, or killed their reader."""
    path.write_bytes(original)
    truth = outcome(guard, path, False)
    ends: Counter[str] = Counter()
    for i, mutant in enumerate(found):
        path.write_bytes(mutant.data)
        reading = outcome(guard, path, salvage=i % 4 == 3)
        try:
            check(path, reading)
            if mutant.points_untouched and isinstance(truth, Reading):
                assert isinstance(reading, Reading)
                assert reading.digest == truth.digest
            if isinstance(reading, Reading) and not mutant.data[104] & 0x80:
                offset, length = int.from_bytes(mutant.data[96:100], "little"), reading.points
                size = length * int.from_bytes(mutant.data[105:107], "little")
                points = mutant.data[offset : offset + size]
                assert offset == 0 or reading.digest == hashlib.blake2b(points).hexdigest()
        except AssertionError as error:
            raise AssertionError(f"{mutant.name}: {reading}: {error}") from error
        died = "the process that reads it" in str(reading)
        ends["read" if isinstance(reading, Reading) else "died" if died else "refused"] += 1
        assert "did not end" not in str(reading), mutant.name
    return ends


@pytest.mark.parametrize("name", FIXTURES)
def test_mutants_of_made_files(
    name: str, make_cloud: Any, tmp_path: Path, guard: ChildProcess
) -> None:
    original = fixture(name, make_cloud).read_bytes()
    ends = hunt(guard, original, tmp_path / name, mutants(original, name, 40))
    assert ends["refused"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", FIXTURES)
def test_many_mutants_of_made_files(
    name: str, make_cloud: Any, tmp_path: Path, guard: ChildProcess
) -> None:
    original = fixture(name, make_cloud).read_bytes()
    ends = hunt(guard, original, tmp_path / name, mutants(original, f"many {name}", 300))
    assert ends["read"] > 10
    assert ends["refused"] > 30


@pytest.mark.slow
def test_many_mutants_of_odd_files(
    shared_data: Path, tmp_path: Path, guard: ChildProcess
) -> None:
    paths = [
        p for p in sorted((shared_data / "odd").glob("*.la[sz]")) if p.stat().st_size <= LARGEST
    ]
    if not paths:
        pytest.skip("no odd files: ../shared/data/odd is absent")
    total: Counter[str] = Counter()
    for path in paths:
        original = path.read_bytes()
        total += hunt(
            guard, original, tmp_path / path.name, mutants(original, f"odd {path.name}", 40)
        )
    assert total["read"] > 50
    assert total["refused"] > 100
