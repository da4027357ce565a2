"""What other runs left in the store, finished or cut off at any write, is in no result."""

from __future__ import annotations

import dataclasses
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
from tests.invariants import clouds
from tests.invariants.runs import do, output_digests
from tests.scenes.small_stores import small_stores
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
    "a part": {"bounds": [500_030.0, 5_400_010.0, 500_100.0, 5_400_110.0]},
    "fewer files": {},
    "water": {"water": "auto"},
}


WRITES = 250
"""Some more than a run does, so that a few end undisturbed."""
ENDLESS = 10**9
"""More writes than any run does."""
SIDE_M = 128.0


class CutOffError(BaseException):
    """The run ends here, as if killed; no Exception, so that nothing handles it."""


@contextmanager
def cut_off(writes: int, out: Path) -> Iterator[list[int]]:
    """A run ends before its write number ``writes``; the first number is the writes that are left to it."""
    left = [writes]

    def counted(write: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **settings: Any) -> Any:
            if threading.current_thread() is not threading.main_thread():
                # a lease renewed meanwhile, as on a slow machine
                return write(*arguments, **settings)
            left[0] -= 1
            if left[0] < 0:
                raise CutOffError
            return write(*arguments, **settings)

        return call

    with pytest.MonkeyPatch.context() as patch, suppress(CutOffError):
        for name in ("put", "delete", "delete_folder"):
            patch.setattr(Storage, name, counted(getattr(Storage, name)))
        yield left
    for lease in ("store.zarr/lock.json", FOLDER_LOCK):  # of this process, which lives on
        (out / lease).unlink(missing_ok=True)


def changes(name: str, files: list[Path]) -> tuple[list[Path], Mapping[str, Any]]:
    return (files[:-1] if name == "fewer files" else files), VARIANTS[name]


@pytest.fixture(scope="module")
def small_files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Four files, smaller than those of other tests, as dozens of runs read them."""
    folder = tmp_path_factory.mktemp("quarters")
    parts = clouds.quarters(clouds.city(SIDE_M))
    return [clouds.write(folder / f"{number}.laz", part) for number, part in enumerate(parts)]


@pytest.fixture(scope="module")
def plain(small_files: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """OUT of a run with the usual settings. Not to be changed."""
    out = tmp_path_factory.mktemp("plain") / "out"
    with pytest.MonkeyPatch.context() as patch:
        small_stores(patch)
        assert do(small_files, out).exit_code == 0
    return out


@pytest.fixture(scope="module")
def alone(
    small_files: list[Path], plain: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], dict[str, str]]:
    """Digests of the outputs of a variant that ran alone."""
    known = {"plain": output_digests(plain)}

    def digests(name: str) -> dict[str, str]:
        if name not in known:
            out = tmp_path_factory.mktemp("alone") / "out"
            paths, settings = changes(name, small_files)
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
        with cut_off(
            ENDLESS if number == 0 and rng.random() < 0.6 else rng.randrange(5, WRITES), out
        ):
            do(paths, out, **settings)
    shutil.rmtree(out / "classified", ignore_errors=True)
    paths, settings = changes(names[-1], files)
    assert do(paths, out, **settings).exit_code == 0
    assert output_digests(out) == expected, names


def history(rng: random.Random) -> list[str]:
    """Some variants; the last was tried before."""
    names = rng.sample(list(VARIANTS), k=rng.choice([2, 2, 3]))
    return [names[-1], *names]


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
)
def test_an_eventful_history(
    seed: int, small_files: list[Path], alone: Callable[[str], dict[str, str]], tmp_path: Path
) -> None:
    rng = random.Random(seed)
    names = history(rng)
    assert_no_trace(names, rng, small_files, tmp_path / "out", alone(names[-1]))


@pytest.mark.parametrize(
    ("other", "shares"),
    [
        ("other pixels", (0.1, 0.6)),
        pytest.param("as many other pixels", (0.05, 0.4, 0.8), marks=pytest.mark.slow),
        pytest.param("fewer files", (0.02, 0.35, 0.6, 0.9), marks=pytest.mark.slow),
        pytest.param("other tiles", (0.05, 0.3, 0.8), marks=pytest.mark.slow),
        pytest.param("two passes", (0.02, 0.3, 0.6), marks=pytest.mark.slow),
        pytest.param("water", (0.1, 0.45, 0.75), marks=pytest.mark.slow),
    ],
)
def test_another_run_cut_off_in_its_writes(
    other: str,
    shares: tuple[float, ...],
    small_files: list[Path],
    plain: Path,
    alone: Callable[[str], dict[str, str]],
    tmp_path: Path,
) -> None:
    """After these shares of its writes, and after the last of them, the first run is made whole again."""
    paths, settings = changes(other, small_files)
    writes = 0
    for share in (1.0, *shares):
        out = Path(shutil.copytree(plain, tmp_path / str(share)))
        allowed = round(share * writes) if writes else ENDLESS
        with cut_off(allowed, out) as left:
            do(paths, out, **settings)
        writes = writes or allowed - left[0]
        assert (left[0] < 0) == (share < 1.0)
        assert do(small_files, out).exit_code == 0
        assert output_digests(out) == alone("plain"), share
    assert writes > 10
