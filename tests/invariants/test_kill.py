"""Killed anywhere and resumed = uninterrupted, byte for byte; and nothing that was finished is done again."""

from __future__ import annotations

import json
import random
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path

import pytest

from ptd.matched.step import MatchedPass
from ptd.methods import METHODS
from tests.invariants import clouds
from tests.invariants.forked import ended, forked
from tests.invariants.runs import EVERY_STAGE, WITH_EVERY_STAGE, all_digests, do, the_store
from tests.scenes.small_stores import USUAL_ROW_POINTS, small_stores
from tests.waiting import wait_until
from tiler.errors import StoreError

pytestmark = pytest.mark.processes

METHOD = "auto"
# a laser scan's
PASSES = sum(not isinstance(step, MatchedPass) for step in METHODS[METHOD].params().passes)
STAGES = ("spool", "assemble", *(f"filter{n}" for n in range(PASSES)), "grid-dtm", "export")
SIDE_M = 96.0
RASTERS_LIKE_ANOTHER = {"grid-slope", "grid-domain", "grid-mask"}
"""Stages whose tasks write and commit as those of `grid-dtm`; a full disk ends each of them in
test_full_disk.py."""
DIFFERENT_STAGES = [stage for stage in EVERY_STAGE if stage not in RASTERS_LIKE_ANOTHER]


@pytest.fixture(autouse=True)
def usual_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that the processes know that are killed."""
    small_stores(monkeypatch, row_points=USUAL_ROW_POINTS)


def finished_tasks(out: Path) -> dict[str, dict[str, str]]:
    """Stage -> key -> digest of the tasks that are committed."""
    try:
        store = the_store(out)
    except StoreError:
        return {stage: {} for stage in STAGES}  # it was killed before there was one
    return {stage: {key: c[0] for key, c in store.committed(stage).items()} for stage in STAGES}


def assert_files_are_whole(out: Path, expected: dict[str, str]) -> None:
    """What lies under its final name is whole, at any moment."""
    assert all_digests(out).items() <= expected.items()
    if (out / "run.json").exists():
        json.loads((out / "run.json").read_text())


@dataclass(frozen=True)
class Peace:
    """Four files, what a run of them leaves that nothing disturbs, and how many events it tells."""

    paths: list[Path]
    expected: dict[str, str]
    events: int


@pytest.fixture(scope="module")
def peace(tmp_path_factory: pytest.TempPathFactory) -> Peace:
    """All that the kills share; small, as there are many."""
    folder = tmp_path_factory.mktemp("peace")
    parts = clouds.quarters(clouds.city(SIDE_M), SIDE_M)
    paths = [clouds.write(folder / f"{number}.laz", part) for number, part in enumerate(parts)]
    assert ended(forked(do, paths, folder / "out", method=METHOD)) == 0
    return Peace(paths, all_digests(folder / "out"), len(lines_of(folder / "out")))


def lines_of(out: Path) -> list[str]:
    """Events so far."""
    log = out / "events.jsonl"
    return log.read_text().splitlines() if log.exists() else []


@pytest.fixture(scope="module")
def more(peace: Peace, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What a run of the same files leaves that has stages of every kind."""
    out = tmp_path_factory.mktemp("more") / "out"
    assert ended(forked(do, peace.paths, out, **WITH_EVERY_STAGE)) == 0
    return all_digests(out)


def kill_at(event: Callable[[], bool], process: BaseProcess, rng: random.Random) -> None:
    """Kill a process a little after an event, or see it end before."""
    wait_until(lambda: not process.is_alive() or event())
    time.sleep(rng.choice([0.0, 0.002, 0.01, 0.03, 0.1]) * rng.random())
    process.kill()
    process.join()


@pytest.mark.slow
@pytest.mark.parametrize("stage", DIFFERENT_STAGES)
def test_killed_in_every_stage(
    stage: str, peace: Peace, more: dict[str, str], tmp_path: Path
) -> None:
    out, wanted = tmp_path / "out", f'"event": "stage_started", "stage": "{stage}"'
    process = forked(do, peace.paths, out, **WITH_EVERY_STAGE)
    kill_at(
        lambda: any(wanted in line for line in lines_of(out)), process, random.Random(stage)
    )
    assert_files_are_whole(out, more)
    assert do(peace.paths, out, **WITH_EVERY_STAGE).exit_code == 0
    assert all_digests(out) == more
    assert not [path for path in out.rglob("*.partial*") if "store.zarr" not in path.parts]
    assert do(peace.paths, out, **WITH_EVERY_STAGE).did_nothing


def events_done(out: Path) -> set[tuple[str, str]]:
    events = [json.loads(line) for line in lines_of(out) if line.endswith("}")]
    # Digests of inputs are kept with the sources, not as a stage: they may be taken again.
    done = Counter(
        (e["stage"], e["key"])
        for e in events
        if e["event"] == "task_done" and e["stage"] in STAGES
    )
    assert max(done.values()) == 1, "a finished task was computed twice"
    return set(done)


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 4))]
)
def test_killed_once_or_more(seed: int, peace: Peace, tmp_path: Path) -> None:
    """Kill the run after each of some events, then let it end."""
    rng, out = random.Random(seed), tmp_path / "out"
    before = finished_tasks(out)
    for _ in range(rng.choice([1, 1, 2, 3]) if seed else 1):
        known = len(lines_of(out)) + rng.randrange(peace.events)
        process = forked(do, peace.paths, out, method=METHOD)
        kill_at(lambda known=known: len(lines_of(out)) > known, process, rng)
        after = finished_tasks(out)
        for stage in STAGES:
            assert before[stage].items() <= after[stage].items(), (
                "what was finished stays finished"
            )
        assert_files_are_whole(out, peace.expected)
        before = after
    result = do(peace.paths, out, method=METHOD)
    assert result.exit_code == 0
    assert all_digests(out) == peace.expected
    for stage in STAGES:
        found = result.summary["stages"][stage]
        assert found["done"] == len(before[stage])
        assert found["computed"] == found["tasks"] - len(before[stage])
    # A write of the store that was cut off leaves a scratch file in it that nothing reads.
    assert not [path for path in out.rglob("*.partial*") if "store.zarr" not in path.parts]
    assert not (out / "store.zarr" / "lock.json").exists()
    assert not (out / ".tiler-lock.json").exists()
    assert events_done(out) <= {
        (stage, key) for stage, tasks in finished_tasks(out).items() for key in tasks
    }
    assert do(peace.paths, out, method=METHOD).did_nothing
