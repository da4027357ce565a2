"""Every filter on every scene with true labels: errors, speed, memory, and published figures, as Markdown.

``python tests/benchmarks/scorecard.py docs/scorecard.md [--methods classic,auto] [--scenes samp] [--repeats 3]
[--json CARD.json] [--keep CARD.json]``

All on one pinned core with compiled kernels: a first run of each filter on each scene gives the labels and
compiles, the fastest of the further ones is the time. Filters see no label, noise and water included. Scenes come
from ``../shared/data`` as far as they are there, and from the simulator. Where the ISPRS samples are there, `auto` is
also chosen on all of them but one and scored on that one (`tests.benchmarks.leave_one_out`).
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from ptd import classify
from ptd.methods import METHODS
from ptd.tin import Pixels, Tin, rasterise
from tests.benchmarks.leave_one_out import leave_one_out
from tests.benchmarks.peers import installed_peers
from tests.benchmarks.scorecard_scenes import (
    ISPRS_SAMPLES,
    BenchScene,
    Cloud,
    real_scenes,
    semi_real_scenes,
    simulated_scenes,
)
from tests.benchmarks.scorecard_text import markdown
from tiler.apps.evaluate import IGNORED, evaluate_labels

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
REFERENCE = "classic"
GROUND = 2

Filter = Callable[[Cloud], np.ndarray]
"""From a cloud to what is ground, bool [n]."""


@dataclass(frozen=True)
class Cell:
    """A filter on a scene.

    Attributes
    ----------
    method, scene, family, group : str
    points : int
    refusal : str or None
        Why there is no result.
    type_1, type_2, total, kappa : float or None
        Fractions.
    dtm_rmse_m : float or None
        Of the linear TIN of what was labelled ground, at pixels of 1 m, where the true terrain is known.
    seconds : float or None
        CPU time of the fastest run.
    peak_bytes : int or None
        Memory above what was there before, at most; None where the system does not tell.
    """

    method: str
    scene: str
    family: str
    group: str
    points: int
    refusal: str | None = None
    type_1: float | None = None
    type_2: float | None = None
    total: float | None = None
    kappa: float | None = None
    dtm_rmse_m: float | None = None
    seconds: float | None = None
    peak_bytes: int | None = None


def all_filters() -> dict[str, Filter]:
    """Our methods, `classic` first, each with its defaults, then the peers that are installed."""

    def own(name: str) -> Filter:
        return lambda cloud: (
            classify(cloud.xyz, name, rgb=cloud.rgb, returns=cloud.returns).classification == GROUND
        )

    names = sorted(METHODS, key=lambda name: (name != REFERENCE, name))
    filters = {name: own(name) for name in names}
    for name, peer in installed_peers().items():
        filters[name] = lambda cloud, peer=peer: peer(cloud.xyz)  # type: ignore[misc]
    return filters


def measure(name: str, run: Filter, scene: BenchScene, cloud: Cloud, repeats: int) -> Cell:
    """Run a filter on a scene: once for the labels, then for the time, which is left out where nothing is repeated."""
    cell = {
        "method": name, "scene": scene.name, "family": scene.family, "group": scene.group, "points": len(cloud.xyz),
    }  # fmt: skip
    try:
        ground = run(cloud)
    except ValueError as refusal:
        return Cell(**cell, refusal=" ".join(str(refusal).split()))
    labels = np.where(ground, GROUND, 1).astype(np.uint8)
    found = evaluate_labels(labels, cloud.classification, IGNORED)
    seconds, peak = [], None
    for _ in range(repeats):
        before = forget_peak()
        start = time.process_time()
        run(cloud)
        seconds.append(time.process_time() - start)
        if before is not None:
            peak = max(peak or 0, resident("VmHWM") - before)
    errors = {key: found[key] for key in ("type_1", "type_2", "total", "kappa")}
    fastest = min(seconds, default=None)
    return Cell(**cell, **errors, dtm_rmse_m=dtm_rmse_m(cloud, ground), seconds=fastest, peak_bytes=peak)


def dtm_rmse_m(cloud: Cloud, ground: np.ndarray) -> float | None:
    """RMSE of the labelled ground's surface at the centres of pixels of 1 m; None without a true terrain."""
    if cloud.truth is None or ground.sum() < 3:
        return None
    side = int(cloud.side_m)
    counts = np.rint(cloud.xyz[ground].T * 1000).astype(np.int32)
    pixels = Pixels(1000, 1, 0, side - 1, side, side)
    surface = rasterise(Tin.build(*counts), pixels).heights / 1000
    centres = np.arange(side) + 0.5
    x, y = np.meshgrid(centres, centres[::-1])
    difference = surface - cloud.truth(x, y)
    return float(np.sqrt(np.nanmean(difference**2)))


def forget_peak() -> int | None:
    """Give freed memory back and let the peak start anew; bytes in use, None where the system does not tell."""
    gc.collect()
    try:
        ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")
    except (OSError, AttributeError):
        return None
    return resident("VmRSS")


def resident(entry: str) -> int:
    """Bytes of memory: VmRSS now, VmHWM at most so far (Linux)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(line for line in lines if line.startswith(entry)).split()[1])


def run_all(
    scenes: Iterable[BenchScene], filters: dict[str, Filter], repeats: int, say: Callable[[str], None]
) -> list[Cell]:
    """Every filter on every scene, scene by scene, so that times of one scene stand beside one another."""
    cells = []
    for scene in scenes:
        cloud = scene.load()
        for name, run in filters.items():
            cell = measure(name, run, scene, cloud, repeats)
            cells.append(cell)
            time_s = "" if cell.seconds is None else f", {cell.seconds:.2f} s"
            told = cell.refusal or f"total {100 * (cell.total or 0):.2f} %{time_s}"
            say(f"{scene.name}: {name}: {told}")
    return cells


def with_kept(cells: Sequence[Cell], kept: Sequence[Cell]) -> list[Cell]:
    """Cells of now and those of an earlier run that were not measured again, scene by scene, `classic` first."""
    now = {(c.scene, c.method) for c in cells}
    both = [*cells, *(c for c in kept if (c.scene, c.method) not in now)]
    scenes = list(dict.fromkeys(c.scene for c in (kept or cells)))
    scenes += [c.scene for c in cells if c.scene not in scenes]
    peers = [c.method for c in both if c.method not in METHODS]
    return sorted(
        both, key=lambda c: (scenes.index(c.scene), c.method in peers, c.method != REFERENCE, c.method)
    )


def main(arguments: Sequence[str] | None = None, scenes: Iterable[BenchScene] | None = None) -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description="Write the scorecard.")
    parser.add_argument("out", type=Path, help="Markdown file")
    parser.add_argument("--json", type=Path, help="the figures as JSON, too")
    parser.add_argument("--methods", help="only these, with commas")
    parser.add_argument("--scenes", help="only scenes whose name or family holds this text")
    parser.add_argument(
        "--keep", type=Path, help="JSON of an earlier run, for all that is not measured again"
    )
    parser.add_argument("--repeats", type=int, default=3, help="timed runs of each")
    given = parser.parse_args(arguments)
    filters = all_filters()
    if given.methods is not None:
        filters = {name: filters[name] for name in given.methods.split(",")}
    chosen = (
        list(scenes)
        if scenes is not None
        else [*real_scenes(DATA), *semi_real_scenes(DATA), *simulated_scenes()]
    )
    if given.scenes is not None:
        chosen = [s for s in chosen if given.scenes in s.name or given.scenes in s.family]
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    cells = run_all(chosen, filters, given.repeats, lambda line: print(line, file=sys.stderr, flush=True))
    if given.keep is not None:
        cells = with_kept(cells, [Cell(**c) for c in json.loads(given.keep.read_text(encoding="utf-8"))])
    samples = {s.name: s.load() for s in chosen if s.family == ISPRS_SAMPLES}
    chosen_without = leave_one_out(samples) if "auto" in filters and len(samples) > 1 else None
    given.out.write_text(markdown(cells, REFERENCE, given.repeats, chosen_without), encoding="utf-8")
    if given.json is not None:
        given.json.write_text(json.dumps([asdict(c) for c in cells], indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
