"""Demonstration: all stages on a simulated city, and scores against its reference data."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from tiler.apps.evaluate import Scene, evaluate_dtm, evaluate_scenes
from tiler.apps.results import DtmScores, SceneReport
from tiler.config import RunConfig
from tiler.core.file_names import link_error
from tiler.errors import ConfigError, write_error
from tiler.io.locations import is_url, local_or_url
from tiler.io.overwrite_check import check_links
from tiler.io.result_folder import CLASSIFIED, EVALUATION
from tiler.observe.events import Listener, Note
from tiler.pipeline import run
from tiler.report.accuracy import write_measured
from tiler.report.html import write_report
from tiler.schedule import fork_server_running
from tiler.simulate import demo_city, demo_files

RESOLUTION_M = Fraction(1)
"""Pixel size of the reference terrain, metres. The DTM is compared with it pixel by pixel."""


MARK = ".tiler-demo"
"""Name of an empty file in OUT/input that is made before the clouds and identifies a demo."""


@dataclass(frozen=True)
class DemoResult:
    """Result of the demonstration: scores of the labels and of the DTM.

    Attributes
    ----------
    summary : mapping
        Summary of the run.
    classes : SceneReport
    dtm : DtmScores
    exit_code : int
        Exit code of the run.
    """

    summary: Mapping[str, Any]
    classes: SceneReport
    dtm: DtmScores
    exit_code: int


# Children that do tasks and children that score them share the imports.
@fork_server_running()
def run_demo(out: str | Path, seed: int, config: RunConfig, listener: Listener) -> DemoResult:
    """Simulate a city in OUT/input, run all stages into OUT, and score its classes and its DTM.

    Parameters
    ----------
    out : path
        Folder OUT of the run.
    seed : int
        Seed of the city. The same seed gives the same clouds, so a second demo has nothing to do.
    config : RunConfig
        Settings of the run. The resolution is replaced by that of the reference terrain, 1 m.
    listener : Listener
        Receives events.

    Raises
    ------
    TilerError
        `tiler.pipeline.run` raises it, or a file that was not made by a demo would be replaced.
    """
    place = local_or_url(out)
    if is_url(place):
        raise ConfigError(f"-o {place}: is a URL; give a folder on this machine")
    out = Path(place)
    _validate_own_files(out, config)
    listener(Note(f"simulating a city of seed {seed} in {out / 'input'}"))
    scene = demo_city(out / "input", seed)
    config = config.updated(resolution=RESOLUTION_M)
    result = run([str(path) for path in scene.paths], str(out), config, listener)
    labelled = [
        Scene(path.stem, out / CLASSIFIED / path.name, truth)
        for path, truth in zip(scene.paths, scene.truth_paths, strict=True)
    ]
    classes = evaluate_scenes(labelled)
    dtm = evaluate_dtm(out / "dtm.tif", scene.dtm_path)
    write_measured(out, EVALUATION, {**classes, "dtm": dtm})
    write_report(out)
    return DemoResult(result.summary, classes, dtm, result.exit_code)


def _validate_own_files(out: Path, config: RunConfig) -> None:
    """Mark the folder as that of a demo. Raise ConfigError if foreign files would be replaced."""
    mark = out / "input" / MARK
    demo_paths = [*demo_files(out / "input"), out / EVALUATION]
    check_links("-o", out, [str(Path(path).relative_to(out)) for path in demo_paths])
    if mark.is_symlink():
        raise link_error(mark, "-o")
    there = [path for path in demo_paths if os.path.lexists(path)]
    if there and not mark.is_file() and not config.force:
        raise ConfigError(
            f"{there[0]}: already exists and was not written by a demo; use another -o, or --force to replace it"
        )
    try:
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.touch()
    except OSError as error:
        raise write_error(str(mark), error, out) from error
