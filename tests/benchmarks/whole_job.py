"""The whole job on some clouds: CPU and wall seconds of each stage, as multiples of one decode of the same files.

    python tests/benchmarks/whole_job.py CLOUD... [--workers N] [--runs N] [--set NAME=VALUE
    ...] [--purposes] [--json FILE]

A decode reads all points of all files with laspy and lazrs, a million at a time, in the
command's own process. It is measured before and after each run, as machines change their pace.
Kernels are compiled before the first run. Of several runs the medians are shown. Memory is that
of the largest worker, and of the command. Other people's filters take part where they are
installed (`tests/benchmarks/peers.py`): labels alone, in memory, of points that were decoded
before. ``--purposes`` adds a run in one process with a profile (`tests/benchmarks/purposes.py`).
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import psutil

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.benchmarks import purposes
from tests.benchmarks.peers import installed_peers, missing_peers
from tiler.apps.warm import warm
from tiler.config import RunConfig
from tiler.observe.events import Event, StageFinished, StageStarted
from tiler.pipeline import run

PIECE_POINTS = 1_000_000
REST = "between stages"
"""Plan, lists of tasks, run.json, report; starting the workers."""


@dataclass(frozen=True)
class Cost:
    """CPU and wall seconds."""

    cpu: float
    wall: float

    def __sub__(self, other: Cost) -> Cost:
        return Cost(self.cpu - other.cpu, self.wall - other.wall)

    @classmethod
    def now(cls) -> Cost:
        """What this process and its children, those that live and those that ended, have taken so far."""
        me = psutil.Process()
        own, cpu = me.cpu_times(), 0.0
        cpu += own.user + own.system + own.children_user + own.children_system
        for child in me.children(recursive=True):
            try:
                times = child.cpu_times()
            except psutil.NoSuchProcess:
                continue
            cpu += times.user + times.system + times.children_user + times.children_system
        return cls(cpu, time.monotonic())


@dataclass
class StageWatch:
    """A listener that takes the cost of each stage; ``stages`` by title, in their order."""

    stages: dict[str, Cost] = field(default_factory=dict)
    _began: tuple[str, Cost] | None = None

    def __call__(self, event: Event) -> None:
        """Take in an event."""
        if isinstance(event, StageStarted):
            self._began = (event.title, Cost.now())
        elif isinstance(event, StageFinished) and self._began is not None:
            title, before = self._began
            spent = Cost.now() - before
            known = self.stages.get(title, Cost(0.0, 0.0))
            self.stages[title] = Cost(known.cpu + spent.cpu, known.wall + spent.wall)
            self._began = None


@dataclass(frozen=True)
class JobCost:
    """A run of the whole job.

    Attributes
    ----------
    points : int
    decode, total : Cost
    stages : dict of str to Cost
        By title; the last is `REST`.
    worker_bytes, command_bytes : int
        Largest resident memory of a worker, and of this process.
    """

    points: int
    decode: Cost
    total: Cost
    stages: dict[str, Cost]
    worker_bytes: int
    command_bytes: int


def decode(paths: Sequence[Path]) -> tuple[int, Cost]:
    """Read all points of some files; how many there were, and what it cost."""
    before, points = Cost.now(), 0
    for path in paths:
        with laspy.open(path, laz_backend=laspy.LazBackend.Lazrs) as reader:
            for piece in reader.chunk_iterator(PIECE_POINTS):
                points += len(piece.x.array)
    return points, Cost.now() - before


def measure(paths: Sequence[Path], settings: dict[str, Any], out: Path) -> JobCost:
    """One run into an empty folder, between two decodes."""
    points, first = decode(paths)
    watch, before = StageWatch(), Cost.now()
    result = run([str(path) for path in paths], out, RunConfig.from_mapping(settings), watch)
    total = Cost.now() - before
    _, second = decode(paths)
    mean = Cost((first.cpu + second.cpu) / 2, (first.wall + second.wall) / 2)
    rest = Cost(
        total.cpu - sum(cost.cpu for cost in watch.stages.values()),
        total.wall - sum(cost.wall for cost in watch.stages.values()),
    )
    stages = result.summary["stages"].values()
    worker = max(stage["peak_rss_bytes"] for stage in stages)
    own = psutil.Process().memory_info().rss
    return JobCost(points, mean, total, {**watch.stages, REST: rest}, worker, own)


def median(costs: Sequence[JobCost]) -> JobCost:
    """Each figure's median; multiples of one decode keep their meaning, as each run has its own."""

    def middle(values: Sequence[Cost]) -> Cost:
        return Cost(
            statistics.median(v.cpu for v in values), statistics.median(v.wall for v in values)
        )

    return JobCost(
        costs[0].points,
        middle([c.decode for c in costs]),
        middle([c.total for c in costs]),
        {
            title: middle([c.stages[title] for c in costs if title in c.stages])
            for title in costs[0].stages
        },
        max(c.worker_bytes for c in costs),
        max(c.command_bytes for c in costs),
    )


def peers(paths: Sequence[Path]) -> dict[str, Cost]:
    """What other people's filters cost, labels alone."""
    found: dict[str, Cost] = {}
    installed = installed_peers()
    if installed:
        xyz = np.concatenate([laspy.read(path).xyz for path in paths])
        for name, label in installed.items():
            before = Cost.now()
            label(xyz)
            found[name] = Cost.now() - before
    return found


def table(job: JobCost, others: dict[str, Cost] | None = None) -> str:
    """A table for people."""
    rows = [
        "| stage | CPU s | wall s | CPU, decodes | wall, decodes |",
        "|---|---:|---:|---:|---:|",
    ]

    def row(title: str, cost: Cost) -> str:
        tick = 0.01  # what the system counts in: a small file may be decoded in none
        times = (cost.cpu / max(job.decode.cpu, tick), cost.wall / max(job.decode.wall, tick))
        return (
            f"| {title} | {cost.cpu:.1f} | {cost.wall:.1f} | {times[0]:.2f} | {times[1]:.2f} |"
        )

    rows += [row(title, cost) for title, cost in job.stages.items()]
    rows += [row("**whole job**", job.total), row("one decode", job.decode)]
    rows += [row(f"{name}, labels alone", cost) for name, cost in (others or {}).items()]
    mb = (job.worker_bytes / 1e6, job.command_bytes / 1e6)
    rows += [
        "",
        f"{job.points:,} points, {1e6 * job.total.cpu / job.points:.2f} CPU s a million.",
    ]
    rows += [
        f"Memory at most: a worker {mb[0]:.0f} MB, the command {mb[1]:.0f} MB when it ended."
    ]
    return "\n".join(rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("clouds", nargs="+", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument(
        "--set", nargs="*", default=[], metavar="NAME=VALUE", help="options of tiler run"
    )
    parser.add_argument("--purposes", action="store_true", help="profile one more run")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(arguments)
    paths = [
        p for c in options.clouds for p in (sorted(c.glob("*.la[sz]")) if c.is_dir() else [c])
    ]
    settings = {"workers": options.workers, **dict(text.split("=", 1) for text in options.set)}
    warm([str(settings.get("method", "auto"))])
    costs = []
    for _ in range(options.runs):
        with tempfile.TemporaryDirectory() as folder:
            costs.append(measure(paths, settings, Path(folder, "out")))
    found, others = median(costs), peers(paths)
    print(table(found, others))
    print("\n".join(f"Not measured: {name}, {why}." for name, why in missing_peers().items()))
    if options.purposes:
        with tempfile.TemporaryDirectory() as folder:
            profiled = purposes.profile(paths, settings, Path(folder, "out"))
        print(f"\n{purposes.table(profiled, found.points)}")
    if options.json is not None:
        options.json.write_text(json.dumps([asdict(cost) for cost in costs], indent=1))


if __name__ == "__main__":
    main()
