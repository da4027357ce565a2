"""Every filter on every scene with true labels: errors, speed, memory, and published figures, as Markdown.

``python tests/benchmarks/scorecard.py docs/scorecard.md [--methods classic,auto] [--scenes samp] [--repeats 3]
[--json CARD.json] [--keep FOLDER]``

All on one pinned core with compiled kernels: a first run of each filter on each scene gives the
labels and compiles, the fastest of the further ones is the time. Filters see no label, noise
and water included. Scenes come from ``../shared/data`` as far as they are there, and from the
simulator. Where the ISPRS samples or the semi-real matched clouds are there, `auto` is also
chosen on all of them but one and scored on that one (`tests.benchmarks.leave_one_out`).

With ``--keep``, what was measured is kept in a folder by a digest of the scene, of the filter's
sources and of these scripts: another run measures what changed, and what an interrupted one had
not reached.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from ptd import classify
from ptd.methods import METHODS
from tests.benchmarks import measuring
from tests.benchmarks.kept import Kept, digest, digest_of_file, digest_of_modules
from tests.benchmarks.leave_one_out import (
    MATCHED_GRID,
    MAX_CHANGED,
    LeaveOneOut,
    leave_one_out,
    matched_default,
    matched_error,
    total_error,
)
from tests.benchmarks.measuring import FLOOR, Cell, Filter, measure, nearest_to_truth
from tests.benchmarks.peers import PEER, digest_of_peers, installed_peers, missing_peers
from tests.benchmarks.scorecard_scenes import (
    ISPRS_SAMPLES,
    SEMI_REAL,
    BenchScene,
    Cloud,
    real_scenes,
    semi_real_scenes,
    simulated_scenes,
)
from tests.benchmarks.scorecard_text import markdown

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
REFERENCE = "classic"
MATCHED = "image matching"
"""Groups of scenes where other programs take part: of laser scans their figures are
published."""


@dataclass(frozen=True)
class Entry:
    """A column of the scorecard: a filter, and a key of all that its labels follow from but the cloud."""

    run: Filter
    key: str


def all_filters() -> dict[str, Entry]:
    """Our methods, `classic` first, each with its defaults, then the peers that are installed, then the floor."""

    def own(name: str) -> Entry:
        def run(cloud: Cloud) -> Any:
            return classify(
                cloud.xyz, name, rgb=cloud.rgb, returns=cloud.returns
            ).classification

        return Entry(run, digest_of_modules(METHODS[name].params.__module__, "ptd.api"))

    names = sorted(METHODS, key=lambda name: (name != REFERENCE, name))
    filters = {name: own(name) for name in names}
    for name, peer in installed_peers().items():
        filters[name] = Entry(lambda cloud, peer=peer: peer(cloud.xyz), digest_of_peers())
    return filters | {FLOOR: Entry(nearest_to_truth, "")}


def takes_part(name: str, scene: BenchScene) -> bool:
    """Whether a filter has a figure on a scene: the floor needs a truth, other programs are run on matched clouds."""
    if name == FLOOR:
        return scene.with_truth
    return not name.endswith(PEER) or MATCHED in f"{scene.group}, {scene.family}"


def _measured(
    name: str, entry: Filter, scene: BenchScene, load: Callable[[], Cloud], again: int
) -> dict[str, Any]:
    return asdict(measure(name, entry.run, scene, load(), again))


def run_all(
    scenes: Iterable[BenchScene],
    filters: Mapping[str, Entry],
    repeats: int,
    say: Callable[[str], None],
    kept: Kept | None = None,
) -> list[Cell]:
    """Every filter on every scene, scene by scene, so that times of one scene stand beside one another."""
    kept = kept or Kept()
    rules = digest(digest_of_file(Path(measuring.__file__)), digest_of_modules("ptd.tin"))
    cells = []
    for scene in scenes:
        cloud = cache(scene.load)
        for name, entry in filters.items():
            if not takes_part(name, scene):
                continue
            # Of other programs only the labels are of interest.
            again = repeats if name in METHODS else 0
            key = digest(
                rules, scene.key(), scene.family, scene.group, name, entry.key, str(again)
            )
            cell = Cell(**kept(key, partial(_measured, name, entry, scene, cloud, again)))
            cells.append(cell)
            time_s = "" if cell.seconds is None else f", {cell.seconds:.2f} s"
            told = cell.refusal or f"total {100 * (cell.total or 0):.2f} %{time_s}"
            say(f"{scene.name}: {name}: {told}")
    return cells


def chosen_settings(
    scenes: Sequence[BenchScene], kept: Kept, auto_key: str
) -> dict[str, LeaveOneOut]:
    """`auto` chosen on all scenes of a family but one, for the families where there is a grid of settings."""
    found = {}
    for family, grid, default, error, most_changed in (
        (ISPRS_SAMPLES, None, None, total_error, None),
        (SEMI_REAL, MATCHED_GRID, matched_default(), matched_error, MAX_CHANGED),
    ):
        own = {scene.name: scene for scene in scenes if scene.family == family}
        if len(own) < 2:
            continue
        loaded = cache(lambda name, own=own: own[name].load())

        def error_of(
            name: str, settings: Mapping[str, Any], own=own, loaded=loaded, error=error
        ) -> float:  # type: ignore[no-untyped-def]
            key = digest("chosen", auto_key, own[name].key(), repr(sorted(settings.items())))
            return float(kept(key, lambda: error(loaded(name), settings)))

        found[family] = leave_one_out(list(own), grid, default, error_of, most_changed)
    return found


def main(
    arguments: Sequence[str] | None = None, scenes: Iterable[BenchScene] | None = None
) -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description="Write the scorecard.")
    parser.add_argument("out", type=Path, help="Markdown file")
    parser.add_argument("--json", type=Path, help="the figures as JSON, too")
    parser.add_argument("--methods", help="only these, with commas")
    parser.add_argument("--scenes", help="only scenes whose name or family holds this text")
    parser.add_argument(
        "--keep", type=Path, help="folder for what was measured, to be used again"
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
    kept = Kept(given.keep)
    cells = run_all(
        chosen,
        filters,
        given.repeats,
        lambda line: print(line, file=sys.stderr, flush=True),
        kept,
    )
    choices = chosen_settings(chosen, kept, filters["auto"].key) if "auto" in filters else {}
    text = markdown(cells, REFERENCE, given.repeats, choices, missing_peers())
    given.out.write_text(text, encoding="utf-8")
    if given.json is not None:
        given.json.write_text(
            json.dumps([asdict(c) for c in cells], indent=1) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main()
