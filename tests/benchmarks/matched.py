"""`auto` and other people's filters on semi-real matched clouds: errors of labels and of the terrain, as Markdown.

``python tests/benchmarks/matched.py [--scans] [--scenes rows,bluff] [--methods auto,CSF] [--thin 1.2] [--keep FOLDER]``

The scenes are those of ``../shared/data/dim/semireal``, with ``--scans`` those made of laser scans
(``tests/benchmarks/scan_scenes.py``); every filter has one setting for all of them and sees no label.
No times, and no choice of settings: see ``tests/benchmarks/scorecard.py``. What `tiler run` makes of these scenes:
``tests/benchmarks/matched_runs.py``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import mean

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.benchmarks.kept import Kept
from tests.benchmarks.measuring import FLOOR, Cell
from tests.benchmarks.peers import digest_of_peers, installed_peers, missing_peers
from tests.benchmarks.scan_scenes import scan_scenes
from tests.benchmarks.scorecard import DATA, Entry, all_filters, run_all
from tests.benchmarks.scorecard_scenes import BenchScene, semi_real_scenes, thinned
from tests.benchmarks.scorecard_text import percent, table


def filters_of(names: Sequence[str] | None = None) -> dict[str, Entry]:
    """`auto`, the peers that are installed, and the floor; or those whose names begin like one of these."""
    own = all_filters()
    peers = {
        name: Entry(lambda cloud, peer=peer: peer(cloud.xyz), digest_of_peers())
        for name, peer in installed_peers(every_cloth=True).items()
    }
    found = {"auto": own["auto"], **peers, FLOOR: own[FLOOR]}
    return {
        n: entry for n, entry in found.items() if names is None or n.startswith(tuple(names))
    }


def text_of(cells: Sequence[Cell]) -> str:
    """A row for each scene, a column for each filter, and the means."""
    methods = list(dict.fromkeys(cell.method for cell in cells))
    rows = [
        [
            scene,
            *(
                _figures([c for c in cells if (c.scene, c.method) == (scene, m)])
                for m in methods
            ),
        ]
        for scene in dict.fromkeys(cell.scene for cell in cells)
    ]
    rows.append(["mean", *(_figures([c for c in cells if c.method == m]) for m in methods)])
    note = "Type I / type II / total in percent, RMSE of the DTM at pixels of 0.5 m."
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


def main(
    arguments: Sequence[str] | None = None, scenes: Iterable[BenchScene] | None = None
) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description="Measure `auto` and its peers on semi-real matched clouds."
    )
    parser.add_argument("--scans", action="store_true", help="scenes made of laser scans")
    parser.add_argument("--scenes", help="only these, with commas")
    parser.add_argument("--methods", help="only those whose names begin so, with commas")
    parser.add_argument(
        "--thin", type=float, help="points per square metre of sparser scenes, taken at random"
    )
    parser.add_argument(
        "--keep", type=Path, help="folder for what was measured, to be used again"
    )
    given = parser.parse_args(arguments)
    chosen = (
        list(scenes)
        if scenes is not None
        else list((scan_scenes if given.scans else semi_real_scenes)(DATA))
    )
    if given.scenes is not None:
        chosen = [scene for scene in chosen if scene.name in given.scenes.split(",")]
    if given.thin is not None:
        chosen = [thinned(scene, given.thin) for scene in chosen]
    if not chosen:
        sys.exit(f"no scene: there is nothing for any of these in {DATA}")
    filters = filters_of(None if given.methods is None else given.methods.split(","))
    cells = run_all(
        chosen,
        filters,
        0,
        lambda line: print(line, file=sys.stderr, flush=True),
        Kept(given.keep),
    )
    print(text_of(cells), flush=True)
    for name, why in missing_peers().items():
        print(f"- {name} is left out: {why}")


if __name__ == "__main__":
    main()
