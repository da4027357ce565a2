"""What other runs left in the store, finished or cut off at any write, is in no result."""

from __future__ import annotations

import dataclasses
import itertools
import random
import shutil
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from ptd.methods import METHODS
from ptd.methods.classic import Classic, ClassicPass
from ptd.passes import Method
from tests.invariants.runs import do, output_digests
from tiler.store.lock import FOLDER_LOCK
from tiler.store.storage import Storage


@dataclasses.dataclass(frozen=True)
class TwoPasses(Classic):
    """A method whose first pass labels otherwise than its last."""

    @property
    def passes(self) -> tuple[ClassicPass, ...]:
        steep = ClassicPass(dataclasses.replace(self, iteration_angle_deg=80.0), "steep")
        return (steep, ClassicPass(self))


@pytest.fixture(autouse=True)
def two_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METHODS, "two", Method("two", "two passes", TwoPasses))


VARIANTS: dict[str, dict[str, Any]] = {
    "plain": {},
    "other tiles": {"tile_size": "96"},
    "other parameters": {"parameters": {"max_building_size": "30"}},
    "other pixels": {"resolution": "2"},
    "as many other pixels": {"max_edge": "3"},
    "two passes": {"method": "two", "parameters": {"iteration_distance": "0.4"}},
    "trust the input": {"method": "keep", "ground_classes": [1]},
    "a part": {"bounds": [500_040.0, 5_400_010.0, 500_150.0, 5_400_170.0]},
    "fewer files": {},
    "water": {"water": "auto"},
}


WRITES = 400
"""Some more than a run does, so that a few end undisturbed."""


class CutOffError(BaseException):
    """The run ends here, as if killed; no Exception, so that nothing handles it."""


@contextmanager
def cut_off(writes: int, out: Path) -> Iterator[None]:
    """A run ends before its write number ``writes``."""
    left = writes

    def counted(write: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **settings: Any) -> Any:
            nonlocal left
            if threading.current_thread() is not threading.main_thread():
                return write(*arguments, **settings)  # a lease renewed meanwhile, as on a slow machine
            left -= 1
            if left < 0:
                raise CutOffError
            return write(*arguments, **settings)

        return call

    with pytest.MonkeyPatch.context() as patch, suppress(CutOffError):
        for name in ("put", "delete", "delete_folder"):
            patch.setattr(Storage, name, counted(getattr(Storage, name)))
        yield
    for lease in ("store.zarr/lock.json", FOLDER_LOCK):  # of this process, which lives on
        (out / lease).unlink(missing_ok=True)


def changes(name: str, files: list[Path]) -> tuple[list[Path], Mapping[str, Any]]:
    return (files[:-1] if name == "fewer files" else files), VARIANTS[name]


@pytest.fixture(scope="module")
def alone(
    quarter_files: list[Path], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], dict[str, str]]:
    """Digests of the outputs of a variant that ran alone."""
    known: dict[str, dict[str, str]] = {}

    def digests(name: str) -> dict[str, str]:
        if name not in known:
            out = tmp_path_factory.mktemp("alone") / "out"
            paths, settings = changes(name, quarter_files)
            assert do(paths, out, **settings).exit_code == 0
            known[name] = output_digests(out)
        return known[name]

    return digests


def assert_no_trace(
    names: list[str], rng: random.Random, files: list[Path], out: Path, expected: dict[str, str]
) -> None:
    """Run the variants but the last up to some write each; the last must give what it gives alone."""
    for number, name in enumerate(names[:-1]):
        paths, settings = changes(name, files)
        with cut_off(10**9 if number == 0 and rng.random() < 0.6 else rng.randrange(5, WRITES), out):
            do(paths, out, **settings)
    shutil.rmtree(out / "classified", ignore_errors=True)
    paths, settings = changes(names[-1], files)
    assert do(paths, out, **settings).exit_code == 0
    assert output_digests(out) == expected, names


def history(rng: random.Random) -> list[str]:
    """Some variants; the last was tried before."""
    names = rng.sample(list(VARIANTS), k=rng.choice([2, 2, 3]))
    return [names[-1], *names]


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_an_eventful_history(
    seed: int, quarter_files: list[Path], alone: Callable[[str], dict[str, str]], tmp_path: Path
) -> None:
    rng = random.Random(seed)
    names = history(rng)
    assert_no_trace(names, rng, quarter_files, tmp_path / "out", alone(names[-1]))


@pytest.mark.processes
@pytest.mark.parametrize(
    ("other", "step"),
    [
        ("other pixels", 17),
        pytest.param("as many other pixels", 37, marks=pytest.mark.slow),
        pytest.param("fewer files", 53, marks=pytest.mark.slow),
        pytest.param("other tiles", 67, marks=pytest.mark.slow),
        pytest.param("two passes", 71, marks=pytest.mark.slow),
        pytest.param("water", 13, marks=pytest.mark.slow),
    ],
)
def test_another_run_cut_off_at_each_write(
    other: str,
    step: int,
    quarter_files: list[Path],
    alone: Callable[[str], dict[str, str]],
    tmp_path: Path,
) -> None:
    out = tmp_path / "out"
    do(quarter_files, out)
    paths, settings = changes(other, quarter_files)
    ended = False
    for writes in itertools.count(3, step):
        with cut_off(writes, out):
            do(paths, out, **settings)
            ended = True
        if ended:
            break
        do(quarter_files, out)
        assert output_digests(out) == alone("plain"), writes
    assert writes > 10
