"""`auto` and other people's filters on semi-real matched clouds: errors of labels and of the terrain, as Markdown.

``python tests/benchmarks/matched.py [--scenes rows,bluff] [--methods auto,CSF] [--no-choice]``

The scenes are those of ``../shared/data/dim/semireal``; every filter has one setting for all of them and sees no label.
Where there are two scenes or more, `auto` is also chosen on all of them but one and scored on that one, over the grid
`GRID`. No times: see ``tests/benchmarks/scorecard.py``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from statistics import mean
from typing import Any
from unittest import mock

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from ptd.matched import passes, surface
from tests.benchmarks.leave_one_out import leave_one_out, total_error
from tests.benchmarks.peers import installed_peers, missing_peers
from tests.benchmarks.scorecard import DATA, GROUND, Cell, Filter, all_filters, run_all
from tests.benchmarks.scorecard_scenes import BenchScene, Cloud, semi_real_scenes
from tests.benchmarks.scorecard_text import chosen_without, percent, table

TRUTH = "true labels"
"""What no filter can do better: the terrain that comes of the true ground points, with their noise."""

GRID: dict[str, tuple[Any, ...]] = {
    "GROUND_M": (0.15, 0.2, 0.25),
    "RIDGE_CONTRAST": ((0.025, 0.075), (0.05, 0.15), (0.1, 0.3)),
}
"""Height above the surface up to which points are ground, and contrast up to which ridges are followed."""

OWNERS = {"GROUND_M": passes, "RIDGE_CONTRAST": surface}
"""Modules whose constants these are."""


def filters_of(names: Sequence[str] | None = None) -> dict[str, Filter]:
    """`auto`, the peers that are installed, and the truth; or those whose names begin like one of these."""
    own = {"auto": all_filters()["auto"]}
    peers = {
        name: (lambda cloud, peer=peer: peer(cloud.xyz))
        for name, peer in installed_peers(every_cloth=True).items()
    }
    truth = {TRUTH: lambda cloud: cloud.classification == GROUND}
    found: dict[str, Filter] = {**own, **peers, **truth}
    return {n: run for n, run in found.items() if names is None or n.startswith(tuple(names))}


def error_with(cloud: Cloud, settings: Mapping[str, Any]) -> float:
    """Total error of `auto` with these constants, a fraction of the points that count."""
    with ExitStack() as replaced:
        for name, value in settings.items():
            replaced.enter_context(mock.patch.object(OWNERS[name], name, value))
        return total_error(cloud, {})


def text_of(cells: Sequence[Cell]) -> str:
    """A row for each scene, a column for each filter, and the means."""
    methods = list(dict.fromkeys(cell.method for cell in cells))
    rows = [
        [scene, *(_figures([c for c in cells if (c.scene, c.method) == (scene, m)]) for m in methods)]
        for scene in dict.fromkeys(cell.scene for cell in cells)
    ]
    rows.append(["mean", *(_figures([c for c in cells if c.method == m]) for m in methods)])
    note = "Type I / type II / total in percent, RMSE of the DTM at pixels of 1 m."
    return f"{note}\n\n" + table(["scene", *methods], rows)


def _figures(cells: Sequence[Cell]) -> str:
    """Means over cells; a scene that was refused leaves no mean."""
    if any(cell.refusal is not None for cell in cells):
        return "refused"
    errors = " / ".join(
        percent(mean(getattr(c, key) for c in cells)) for key in ("type_1", "type_2", "total")
    )
    rmses = [cell.dtm_rmse_m for cell in cells if cell.dtm_rmse_m is not None]
    return f"{errors}, {mean(rmses):.2f} m" if len(rmses) == len(cells) else errors


def main(arguments: Sequence[str] | None = None, scenes: Iterable[BenchScene] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Measure `auto` and its peers on semi-real matched clouds.")
    parser.add_argument("--scenes", help="only these, with commas")
    parser.add_argument("--methods", help="only those whose names begin so, with commas")
    parser.add_argument("--no-choice", action="store_true", help="do not choose `auto` on all scenes but one")
    given = parser.parse_args(arguments)
    chosen = list(scenes) if scenes is not None else list(semi_real_scenes(DATA))
    if given.scenes is not None:
        chosen = [scene for scene in chosen if scene.name in given.scenes.split(",")]
    if not chosen:
        sys.exit(f"no scene: there is none of these in {DATA / 'dim/semireal'}")
    filters = filters_of(None if given.methods is None else given.methods.split(","))
    cells = run_all(chosen, filters, 0, lambda line: print(line, file=sys.stderr, flush=True))
    print(text_of(cells), flush=True)
    for name, why in missing_peers().items():
        print(f"- {name} is left out: {why}")
    if not given.no_choice and len(chosen) > 1:
        default = {name: getattr(OWNERS[name], name) for name in GRID}
        clouds = {scene.name: scene.load() for scene in chosen}
        print("\n" + chosen_without(leave_one_out(clouds, GRID, default, error_with)))


if __name__ == "__main__":
    main()
