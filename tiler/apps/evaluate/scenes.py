"""Evaluation of many clouds: pairs with references, scores per scene and of all points, and means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory

from tiler.apps.classify import classify_file
from tiler.apps.evaluate.clouds import IGNORED, LabelComparison, compare_files, mean_scores
from tiler.apps.evaluate.maps import ErrorGrid, write_error_map
from tiler.apps.results import (
    FilteredScene,
    FilterReport,
    Pairing,
    SceneReport,
    SceneScores,
)
from tiler.config import RunConfig
from tiler.core.units import METRE
from tiler.errors import ConfigError, ProcessingError
from tiler.inputs import find_inputs, inspect
from tiler.io.locations import is_url, with_slashes
from tiler.observe.events import Listener, Note, ignore_events
from tiler.schedule import call_isolated, fork_server_running, half_of_memory


@dataclass(frozen=True)
class Scene:
    """Cloud to score, and the cloud with its reference classes.

    Attributes
    ----------
    name : str
    cloud, reference : Path
    """

    name: str
    cloud: Path
    reference: Path


@dataclass(frozen=True)
class MapRequest:
    """Request for error maps: their folder and cell size.

    Attributes
    ----------
    folder : Path
    cell_m : Fraction
        Side of a cell, metres.
    """

    folder: Path
    cell_m: Fraction = Fraction(1)


def find_scenes(clouds: Sequence[str | Path], references: Sequence[str | Path]) -> list[Scene]:
    """Pair each cloud with its reference.

    Parameters
    ----------
    clouds, references : sequence of path
        Files, folders, globs. A single cloud is paired with all references. Equal numbers of clouds and references
        that are given one by one are paired in their order. Otherwise a reference is paired with the cloud of the same
        name (without suffix). Among several such clouds, the one with the same path within its given folder counts.

    Raises
    ------
    ConfigError
        A path does not exist, or a reference fits no cloud or several clouds.
    InputError
        There are no files.
    """
    cloud_paths, true = _expanded(clouds), _expanded(references)
    one_by_one = len(cloud_paths) == len(clouds) and len(true) == len(references)
    if len(cloud_paths) == 1:
        partners = [cloud_paths[0][0]] * len(true)
    elif one_by_one and len(cloud_paths) == len(true):
        partners = [path for path, _ in cloud_paths]
    else:
        partners = [_partner(cloud_paths, path, relative_path) for path, relative_path in true]
    names = _names(true)
    return [
        Scene(name, cloud, path)
        for name, cloud, (path, _) in zip(names, partners, true, strict=True)
    ]


def _partner(clouds: Sequence[tuple[Path, str]], reference: Path, place: str) -> Path:
    """Return the cloud that belongs to a reference. Raise ConfigError if there is none, or more than one."""
    matches = [cloud for cloud in clouds if cloud[0].stem == reference.stem]
    if len(matches) > 1:
        matches = [cloud for cloud in matches if cloud[1] == place]
    if len(matches) != 1:
        raise ConfigError(
            f"{reference}: {len(matches) or 'none'} of the {len(clouds)} clouds {'are' if matches else 'is'} named "
            f"{reference.stem}; give references the names of their clouds, or list both in the same order"
        )
    return matches[0][0]


def _expanded(paths: Sequence[str | Path]) -> list[tuple[Path, str]]:
    """Return files in the order of ``paths``, with their paths (without suffix) in the given folder."""
    relative_paths: dict[Path, str] = {}
    for text in paths:
        for path in find_inputs([text], results=True):
            relative = Path(path.name.partition("?")[0] if is_url(path) else path.name)
            if Path(text).is_dir():
                relative = path.relative_to(text)
            relative_paths.setdefault(path, relative.with_suffix("").as_posix())
    return list(relative_paths.items())


def _names(references: Sequence[tuple[Path, str]]) -> list[str]:
    """Return unique names of the references, with their folders or a number if necessary."""
    for names in (
        [path.stem for path, _ in references],
        [relative_path.replace("/", "_") for _, relative_path in references],
    ):
        if len(set(names)) == len(names):
            return names
    return [f"{path.stem}-{number}" for number, (path, _) in enumerate(references, start=1)]


# Children that compare scenes share the imports.
@fork_server_running()
def evaluate_scenes(
    scenes: Sequence[Scene],
    ignore: Sequence[int] = IGNORED,
    maps: MapRequest | None = None,
    listener: Listener = ignore_events,
) -> SceneReport:
    """Score each scene, and the points of all scenes together.

    Parameters
    ----------
    scenes : sequence of Scene
    ignore : sequence of int
        Reference classes that are left out.
    maps : MapRequest, optional
        Request for a map of the errors of each scene.
    listener : callable
        Receives events, see `tiler.observe.events`.

    Raises
    ------
    TilerError
    """
    total = LabelComparison()
    results: list[SceneScores] = []
    for scene in scenes:
        listener(Note(f"{scene.name}: {scene.cloud} against {scene.reference}"))
        findings, how, written = call_isolated(
            _compare,
            scene,
            ignore,
            maps,
            paths=(scene.cloud, scene.reference),
            memory_bytes=half_of_memory(),
        )
        total.table += findings.table
        total.withheld += findings.withheld
        results.append(
            {
                "name": scene.name,
                "cloud": with_slashes(scene.cloud),
                "reference": with_slashes(scene.reference),
                **findings.facts(ignore),
                **how,
                "maps": written,
            }
        )
    return {
        **total.facts(ignore),
        "unmatched_reference": sum(
            scene_scores["unmatched_reference"] for scene_scores in results
        ),
        "unmatched_cloud": sum(scene_scores["unmatched_cloud"] for scene_scores in results),
        "mean": mean_scores(results),
        "scenes": results,
    }


def _compare(
    scene: Scene, ignore: Sequence[int], maps: MapRequest | None
) -> tuple[LabelComparison, Pairing, list[str]]:
    """Return the counts of a scene, how its points were paired, and the paths of its maps."""
    if maps is None:
        return *compare_files(scene.cloud, scene.reference), []
    georeference = inspect(scene.reference).georeference
    grid = ErrorGrid(maps.cell_m / (georeference.horizontal or METRE), ignore)
    findings, how = compare_files(scene.cloud, scene.reference, grid)
    findings.grid = None  # The caller does not need the grid, which may be large.
    return findings, how, write_error_map(grid, maps.folder, scene.name, georeference.wkt)


@fork_server_running()
def filter_and_evaluate(
    clouds: Sequence[str | Path],
    config: RunConfig,
    ignore: Sequence[int] = IGNORED,
    maps: MapRequest | None = None,
    listener: Listener = ignore_events,
) -> FilterReport:
    """Filter clouds with reference classes, which the filter does not use, and score the result.

    All points take part except withheld ones, which are not judged either. A run usually keeps
    some classes (noise, water, bridges), which here would give a part of the reference to the
    filter.

    Parameters
    ----------
    clouds : sequence of path
        Files, folders, globs, with reference classes.
    config : RunConfig
        Settings of the filter. ``keep_classes`` is not used.
    ignore, maps, listener
        See `evaluate_scenes`.

    Raises
    ------
    TilerError
    """
    blind = config.updated(keep_classes=())
    listener(Note("the classes of the clouds are not shown to the filter"))
    with TemporaryDirectory(prefix=".tiler-evaluate-") as scratch:
        scenes, filtered = [], []
        for number, scene in enumerate(find_scenes(clouds, clouds)):
            target = Path(scratch) / f"{number}.laz"
            made = classify_file(scene.reference, target, blind, listener)
            if failed := made["failed_tasks"]:
                raise ProcessingError(
                    f"{scene.reference}: not scored, as {len(failed)} of its tasks failed ({failed[0]['title']} "
                    f"{failed[0]['key']}: {failed[0]['error']}); its points there have their true classes"
                )
            filtered.append(made)
            scenes.append(Scene(scene.name, target, scene.reference))
        scores = evaluate_scenes(scenes, ignore, maps)
    results: list[FilteredScene] = [
        {**result, "cloud": result["reference"], "seconds": made["seconds"]}
        for result, made in zip(scores["scenes"], filtered, strict=True)
    ]
    parameters = filtered[0]["parameters"]
    return {**scores, "scenes": results, "method": config.method, "parameters": parameters}
