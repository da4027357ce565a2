"""Fits the constants of `tiler.grid.unsure_terrain`, and scores each family of scenes with those of the others.

``python -m tests.benchmarks.unsure FOLDER [--kind als] [--seeds 960,990] [--fresh 1300,1400,1500]``

Laser scans and their runs in FOLDER are those of `tests.benchmarks.left_objects`. With ``--kind dim``, the scenes are
all photogrammetric ones whose terrain is known, and seeds are added to those of the simulator's. Scenes of the seeds of
``--fresh`` are scored with the constants of all others, and with those of the program. Squares have four positions. A
place is wrong as in `tests.benchmarks.places`.
Markdown goes to the standard output.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.optimize import minimize

from tests.benchmarks.left_objects import (
    AREA_M2,
    COVERED,
    HIGH_M,
    TOUCHING,
    Pixels,
    other_scenes,
    pixels_of,
)
from tests.benchmarks.places import (
    KNOWN_SHARE,
    WRONG_M,
    WRONG_M2,
    WRONG_SHARE,
    ranges,
    simulated,
)
from tests.benchmarks.places import WRONG_SHARE_OF_SMALL as OF_SMALL
from tests.benchmarks.scan_scenes import scan_scenes
from tests.benchmarks.scorecard import DATA
from tests.benchmarks.scorecard_scenes import BenchScene
from tests.benchmarks.scorecard_text import table
from tests.benchmarks.sigma_scenes import Known, known_scenes
from tiler.grid.unsure_terrain import (
    LEAST_SUM,
    RIM_CELLS,
    SEARCHES,
    SQUARE_M,
    Search,
    Weights,
    measured,
    shape_of,
)
from tiler.simulate import SCENES

RIDGE = 2.0
CORNERS = tuple(itertools.product((0, int(SQUARE_M / 2)), repeat=2))
"""Positions of the squares that cut places. Each counts as a scene, since scenes are small."""
GROUPS = {
    "forest": "woods", "mountain": "woods", "bluff": "woods", "terraces": "slopes", "village": "slopes",
    "hills": "bare hills", "IGN": "AHN3 and IGN", "AHN3": "AHN3 and IGN",
}  # fmt: skip


class Sample(NamedTuple):
    """Candidates of a scene: labels, sums, measures; which are known, and which are wrong; errors (NaN: unknown)."""

    family: str
    labels: np.ndarray
    squared: np.ndarray
    measures: np.ndarray
    is_known: np.ndarray
    is_wrong: np.ndarray
    error: np.ndarray
    cell_m: float
    search: Search


def sample_of(
    name: str, pixels: Pixels, search: Search, corner: tuple[int, int] = (0, 0)
) -> Sample:
    """The candidates of the pixels of a scene whose first cell has this row and column."""
    heights, ground, objects, error, cell_m = pixels
    # As in a run, there is no terrain beyond the raster.
    heights, error = (np.pad(a, RIM_CELLS, constant_values=np.nan) for a in (heights, error))
    ground, objects = (np.pad(a.astype(np.int64), RIM_CELLS) for a in (ground, objects))
    shape = shape_of(heights, cell_m)
    least = search.least_measure
    labels, squared, measures = measured(shape, ground, objects, cell_m, least, corner)
    low, high = ranges(heights - error)
    known = ~np.isnan(error)
    off = known & (np.maximum(heights - high, low - heights) > WRONG_M)
    sizes, known_m2, off_m2 = (
        np.bincount(labels.ravel(), cells.ravel(), squared.size + 1)[1:] * cell_m**2
        for cells in (labels > 0, known, off)
    )
    least = np.minimum(np.maximum(WRONG_M2, WRONG_SHARE * known_m2), OF_SMALL * known_m2)
    is_wrong = (off_m2 > 0) & (off_m2 >= least)
    is_known = known_m2 >= KNOWN_SHARE * sizes
    return Sample(
        family_of(name), labels, squared, measures, is_known, is_wrong, error, cell_m, search
    )


def family_of(name: str) -> str:
    """The site of a laser scan, where all samples of a producer are one family, or a photogrammetric scene."""
    if name.startswith("scan_"):
        return name
    words = name.removeprefix("als_").removeprefix("dim_").removeprefix("area_").split("_")
    return "ISPRS" if words[0].startswith("samp") else words[0]


def group_of(family: str) -> str:
    """The group of scenes in the table."""
    if family.startswith("scan_"):
        return "made of laser scans"
    return GROUPS.get(
        family, "ISPRS" if family == "ISPRS" else "towns, halls, quarries, rivers, parks"
    )


def fitted(samples: Iterable[Sample]) -> Weights:
    """The weights that make what is known most likely. A scene weighs as the root of its number of candidates."""
    used = [s for s in samples if s.is_known.any()]
    columns = np.concatenate([s.measures[s.is_known] for s in used])
    wrong = np.concatenate([s.is_wrong[s.is_known] for s in used])
    numbers = [int(s.is_known.sum()) for s in used]
    weight = np.repeat([max(n, 20) ** -0.5 for n in numbers], numbers)
    weight *= weight.size / weight.sum()
    middle, spread = columns.mean(axis=0), np.maximum(columns.std(axis=0), 1e-9)
    scaled = np.column_stack((np.ones(len(wrong)), (columns - middle) / spread))

    def loss(by: np.ndarray) -> float:
        odds = scaled @ by
        misfit = (weight * (np.logaddexp(0, odds) - wrong * odds)).sum()
        return float(misfit + RIDGE * (by[1:] ** 2).sum())

    by = minimize(loss, np.zeros(scaled.shape[1])).x
    factors = by[1:] / spread
    return Weights(*np.append(by[0] - factors @ middle, factors).tolist())


class Score(NamedTuple):
    """Area, places, those judged, wrong ones, objects left, those found, squared errors in m2: all, in places."""

    km2: float
    places: int
    judged: int
    wrong: int
    objects: int
    found: int
    squared: float
    in_places: float


def scored(sample: Sample, weights: Weights) -> Score:
    """The places of a scene against the truth."""
    by = np.array(weights)
    chance = 1 / (1 + np.exp(-(by[0] + sample.measures @ by[1:])))
    is_listed = (chance >= sample.search.least_chance) & (sample.squared >= LEAST_SUM)
    taken = np.append(False, is_listed)[sample.labels]
    error, m2 = np.nan_to_num(sample.error), sample.cell_m**2
    numbers, n = ndimage.label(error > HIGH_M, TOUCHING)
    sizes = np.bincount(numbers.ravel(), minlength=n + 1) * m2
    objects = 1 + np.flatnonzero(sizes[1:] >= AREA_M2)
    covered = np.asarray(ndimage.mean(taken, numbers, objects)) if objects.size else np.zeros(0)
    return Score(
        float(np.count_nonzero(~np.isnan(sample.error)) * m2 / 1e6),
        int(is_listed.sum()),
        int((is_listed & sample.is_known).sum()),
        int((is_listed & sample.is_known & sample.is_wrong).sum()),
        objects.size,
        int((covered >= COVERED).sum()),
        float((error**2).sum() * m2),
        float((error[taken] ** 2).sum() * m2),
    )


def report(samples: Sequence[Sample], fresh: Sequence[Sample]) -> str:
    """Each group with the weights of the other families, the fresh scenes, and the weights of all."""
    weights = fitted(samples)
    rows = []
    kinds = (
        ("", samples, None),
        ("fresh, fitted: ", fresh, weights),
        ("fresh: ", fresh, samples[0].search.weights),
    )
    for kind, scenes, given in kinds:
        groups: dict[str, list[Score]] = {}
        for sample in scenes:
            others = [s for s in samples if s.family != sample.family]
            by = given or fitted(others)
            groups.setdefault(kind + group_of(sample.family), []).append(scored(sample, by))
        rows += [row_of(name, scores) for name, scores in groups.items()]
    head = [
        "scenes", "number", "places per km2", "places judged", "wrong", "objects left", "found", "squared error, %",
    ]  # fmt: skip
    return f"{table(head, rows)}\n\n{weights}"


def row_of(name: str, scores: Sequence[Score]) -> list[str]:
    """The row of a group."""
    total = Score(*(sum(column) for column in zip(*scores, strict=True)))
    share = 100 * total.in_places / max(total.squared, 1e-9)
    counts = (total.judged, total.wrong, total.objects, total.found)
    per_km2 = total.places / total.km2
    return [
        name,
        str(len(scores) // len(CORNERS)),
        f"{per_km2:.0f}",
        *map(str, counts),
        f"{share:.0f}",
    ]


def made_of_scans() -> Iterator[Known]:
    """The photogrammetric clouds made of laser scans."""
    for scene in scan_scenes(DATA):
        name = "scan_" + "_".join(scene.name.replace(",", "").split())
        yield Known(name, "dim", "real", scene)


def other_matched(step: int) -> Iterator[Known]:
    """The photogrammetric scenes of the simulator with ``step`` added to their seeds."""
    for name, spec in SCENES.items():
        if spec.kind == "dim":
            load = partial(simulated, replace(spec, seed=spec.seed + step), False)
            scene = BenchScene(name, "", "", load)
            yield Known(f"{name}_f{step}", "dim", "simulated", scene)


KINDS = {
    "als": (SEARCHES["lidar"], other_scenes),
    "dim": (SEARCHES["dim"], other_matched),
}
"""For each kind, the search, and the function of other scenes."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run, fit, print."""
    parser = argparse.ArgumentParser(description="Fit and score the finder of unsure terrain.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", default="960,990", help="first seeds of other sites")
    parser.add_argument(
        "--fresh", default="1300,1400,1500", help="seeds of scenes to score only"
    )
    parser.add_argument("--kind", choices=tuple(KINDS), default="als")
    given = parser.parse_args(arguments)
    search, others = KINDS[given.kind]
    known = [scene for scene in known_scenes(DATA) if scene.kind == given.kind]
    if given.kind == "dim":
        known += made_of_scans()
    sets = [known, []]
    for scenes, seeds in zip(sets, (given.seeds, given.fresh), strict=True):
        for seed in filter(None, seeds.split(",")):
            scenes += others(int(seed))
    samples, fresh = (
        [
            sample_of(k.name, pixels, search, corner)
            for k in scenes
            for pixels in [pixels_of(k, given.folder)]
            for corner in CORNERS
        ]
        for scenes in sets
    )
    print(report(samples, fresh))


if __name__ == "__main__":
    main()
