"""`auto` and the filters that pip installs on the ISPRS samples of laser scans: errors and agreement, as Markdown.

``python -m tests.benchmarks.laser [--scenes samp11,samp12] [--methods auto,CSF]``

Every filter has one setting for all samples, declared in `tests/benchmarks/peers.py`, and sees no label.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from statistics import mean

from tests.benchmarks.measuring import Cell, measure
from tests.benchmarks.peers import (
    installed_peers,
    laser_peers,
    missing_laser_peers,
    missing_peers,
)
from tests.benchmarks.scorecard import DATA, Entry, all_filters
from tests.benchmarks.scorecard_scenes import ISPRS_SAMPLES, BenchScene, real_scenes
from tests.benchmarks.scorecard_text import percent, table

FIGURES = {
    "type_1": "type I",
    "type_2": "type II",
    "total": "total",
    "kappa": "kappa",
    "iou": "IoU",
    "mcc": "MCC",
}


def filters_of(names: Sequence[str] | None = None) -> dict[str, Entry]:
    """`auto` and the peers that are installed; or those whose names begin like one of these."""
    peers = {**installed_peers(), **laser_peers()}
    found = {"auto": all_filters()["auto"]}
    for name, peer in peers.items():
        found[name] = Entry(lambda cloud, peer=peer: peer(cloud.xyz), "")
    return {
        n: entry for n, entry in found.items() if names is None or n.startswith(tuple(names))
    }


def text_of(cells: Sequence[Cell]) -> str:
    """A row of means for each filter, then its total error on each sample."""
    scenes = list(dict.fromkeys(cell.scene for cell in cells))
    rows = []
    for method in dict.fromkeys(cell.method for cell in cells):
        own = {cell.scene: cell for cell in cells if cell.method == method}
        means = [_mean([getattr(cell, name) for cell in own.values()]) for name in FIGURES]
        rows.append([method, *means, *(percent(own[scene].total) for scene in scenes)])
    return table(["filter", *FIGURES.values(), *scenes], rows)


def _mean(values: Sequence[float | None]) -> str:
    """The mean in percent; a sample without the figure leaves none."""
    known = [value for value in values if value is not None]
    return percent(mean(known)) if len(known) == len(values) else "-"


def main(
    arguments: Sequence[str] | None = None, scenes: Iterable[BenchScene] | None = None
) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scenes", help="only these, with commas")
    parser.add_argument("--methods", help="only those whose names begin so, with commas")
    given = parser.parse_args(arguments)
    chosen = list(real_scenes(DATA) if scenes is None else scenes)
    chosen = [scene for scene in chosen if scene.family == ISPRS_SAMPLES]
    if given.scenes is not None:
        chosen = [scene for scene in chosen if scene.name in given.scenes.split(",")]
    if not chosen:
        sys.exit(f"no scene: there is nothing for any of these in {DATA}")
    filters = filters_of(None if given.methods is None else given.methods.split(","))
    cells = []
    for scene in chosen:
        cloud = scene.load()
        for name, entry in filters.items():
            cells.append(measure(name, entry.run, scene, cloud, 0))
            print(f"{scene.name}: {name}: {percent(cells[-1].total)}", file=sys.stderr)
    print(text_of(cells), flush=True)
    for name, why in {**missing_laser_peers(), **missing_peers()}.items():
        print(f"- {name} is left out: {why}")


if __name__ == "__main__":
    main()
