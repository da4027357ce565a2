"""Fits the constants of `tiler.grid.object_candidates`, and scores each scene with those of the other scenes.

``python -m tests.benchmarks.left_objects FOLDER [--scenes als_city,samp11] [--seeds 900,950,990]``

The scenes are the laser scans of `tests.benchmarks.sigma_scenes`, and other sites of the simulator with these seeds.
Each is filtered and gridded with the default settings; the runs stay in FOLDER. An object is left where the terrain
rises more than `HIGH_M` above the true one over `AREA_M2`, and is found if places cover `COVERED` of it. A place is
right if the terrain is `WRONG_M` too high in `RIGHT` of it. Markdown goes to the standard output.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.optimize import minimize

from tests.benchmarks.scorecard import DATA
from tests.benchmarks.scorecard_scenes import BenchScene, Cloud
from tests.benchmarks.scorecard_text import table
from tests.benchmarks.sigma_scenes import CORNER, Known, known_scenes, placed, ran
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.points import LABELS, STRAY_FLAG, WITHHELD_FLAG
from tiler.core.raster import NODATA, Block, RasterSpec
from tiler.grid.block_surroundings import PointsNear
from tiler.grid.left_objects import CELL_M
from tiler.grid.object_candidates import (
    Candidates,
    Level,
    Measures,
    Weights,
    candidates,
    chances,
    chosen,
    measures_of,
)
from tiler.grid.records import GroundSelection
from tiler.grid.stage import MATCHED_EROSION
from tiler.simulate.catalogue import SceneSpec
from tiler.simulate.points import survey
from tiler.store import open_store

HIGH_M, AREA_M2, COVERED = 1.0, 4.0, 0.3
WRONG_M, RIGHT = 0.5, 0.4
KNOWN = 0.5
"""A place counts if the true terrain is known in this share of it."""
FIRST = 50
RIDGE = 1.0
PAD = 8
TOUCHING = np.ones((3, 3))
SITES = (
    ("city", 5.0, 250.0), ("suburb", 4.0, 250.0), ("halls", 3.0, 300.0), ("rows", 8.0, 200.0),
    ("industry", 4.0, 300.0), ("village", 6.0, 220.0), ("mixed", 3.0, 260.0), ("park", 6.0, 200.0),
    ("river", 3.0, 250.0), ("terraces", 4.0, 240.0), ("quarry", 3.0, 260.0), ("hills", 3.0, 260.0),
    ("forest", 5.0, 200.0), ("mountain", 4.0, 260.0), ("bluff", 5.0, 200.0),
)  # fmt: skip
"""Sites with the density per square metre and the side in metres."""


def other_scenes(seed: int) -> Iterator[Known]:
    """Sites of the simulator whose seeds begin at ``seed``."""
    for i, (site, density, side_m) in enumerate(SITES):
        name = f"{site}_{seed + i}"
        spec = SceneSpec(name, "als", "", "", site, seed + i, side_m, {"density": density})
        scene = BenchScene(name, "", "", partial(_simulated, spec))
        yield Known(name, "als", "simulated", scene)


def _simulated(spec: SceneSpec) -> Cloud:
    site = spec.make_site()
    points = survey(site, spec.make_sensor())
    returns = np.column_stack((points.number, points.count))
    truth = site.terrain.height_at
    return Cloud(points.xyz, points.label, points.rgb, returns, truth, spec.side_m)


class Sample(NamedTuple):
    """Candidates of a scene, whether each is right and known, and the errors of the cells in metres (NaN: unknown)."""

    name: str
    found: Candidates
    levels: list[Level]
    measures: Measures
    is_right: np.ndarray
    is_known: np.ndarray
    error: np.ndarray
    cell_m: float


class Pixels(NamedTuple):
    """Pixels of a run of a scene: heights, numbers of ground points and of others, errors (NaN: unknown), and side."""

    heights: np.ndarray
    ground: np.ndarray
    objects: np.ndarray
    error: np.ndarray
    cell_m: float


def sampled(known: Known, folder: Path) -> Sample:
    """The candidates of a run of a scene, in cells of one pixel."""
    return sample_of(known.name, *pixels_of(known, folder))


def pixels_of(known: Known, folder: Path) -> Pixels:
    """The pixels of a run of a scene, or cells of about 1 m, and some around, which are not known."""
    store = open_store(str(ran(known, folder) / "store.zarr"))
    spec = RasterSpec.from_json(store.get_state("raster-dtm-outlined"))
    block = Block(0, 0, spec.height, spec.width)
    values = store.read_block("dtm-outlined", block).astype(np.float64)
    heights = np.where(values == NODATA, np.nan, values)
    rule = GroundSelection(LABELS, skip_flags=WITHHELD_FLAG | STRAY_FLAG)
    points = PointsNear(store, rule, spec, block)
    ground = points.ground_per_pixel()
    objects = points.surface_per_pixel()[0] - ground
    if known.kind == "dim":
        erode = store.meta.frame.counts(MATCHED_EROSION)
        eroded = replace(rule, erode=erode, erode_rise=COUNTS_PER_UNIT)
        ground = PointsNear(store, eroded, spec, block).ground_per_pixel()
    x, y = (
        centres / COUNTS_PER_UNIT - corner
        for centres, corner in zip(spec.centres(block), CORNER, strict=True)
    )
    truth = placed(known.scene).truth
    assert truth is not None
    error = heights - truth(x, y)
    pixel_m = float(spec.lattice.size * store.meta.frame.metres_xy)
    side = max(round(CELL_M / pixel_m), 1)
    heights, error = (_in_cells(a, side, np.nan, np.nanmean) for a in (heights, error))
    ground, objects = (_in_cells(a, side, 0, np.sum) for a in (ground, objects))
    # As in a run, there is no terrain beyond the raster.
    heights, error = (np.pad(cells, PAD, constant_values=np.nan) for cells in (heights, error))
    ground, objects = (np.pad(cells, PAD) for cells in (ground, objects))
    return Pixels(heights, ground, objects, error, side * pixel_m)


def _in_cells(
    values: np.ndarray, side: int, beyond: float, reduced: Callable[..., np.ndarray]
) -> np.ndarray:
    """Values of cells of some pixels on a side."""
    rows, columns = (-(-size // side) * side for size in values.shape)
    whole = np.full((rows, columns), beyond, values.dtype)
    whole[: values.shape[0], : values.shape[1]] = values
    parts = whole.reshape(rows // side, side, columns // side, side)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # A cell may have no height.
        return reduced(parts, axis=(1, 3))


def sample_of(
    name: str,
    heights: np.ndarray,
    ground: np.ndarray,
    objects: np.ndarray,
    error: np.ndarray,
    cell_m: float,
) -> Sample:
    """The candidates of cells whose errors are known."""
    found, levels = candidates(heights, cell_m)
    measures = measures_of(found, levels, ground, objects, cell_m)
    wrong, seen = [np.zeros(0)], [np.zeros(0)]
    for level in levels:
        seen.append(level.mean(~np.isnan(error), level.inside))
        wrong.append(level.mean(np.nan_to_num(error) > WRONG_M, level.inside))
    share, there = np.concatenate(wrong), np.concatenate(seen)
    is_right = share >= RIGHT * np.maximum(there, 1e-9)
    return Sample(name, found, levels, measures, is_right, there > KNOWN, error, cell_m)


def fitted(samples: Sequence[Sample]) -> Weights:
    """The weights that make what is known most likely. A scene weighs as the root of its number of candidates."""
    rows, right, weight = [], [], []
    for sample in samples:
        used = sample.measures.is_judged & sample.is_known
        m = sample.measures
        columns = np.ones(used.size), m.objects, m.slope, m.border_ground
        rows.append(np.column_stack(columns)[used])
        right.append(sample.is_right[used])
        weight.append(np.full(used.sum(), max(used.sum(), 20) ** -0.5))
    X, y, w = np.concatenate(rows), np.concatenate(right), np.concatenate(weight)
    w *= y.size / w.sum()
    spread = np.append(1.0, X[:, 1:].std(axis=0))

    def loss(by: np.ndarray) -> float:
        odds = X @ by
        return float(
            (w * (np.logaddexp(0, odds) - y * odds)).sum()
            + RIDGE * ((spread * by)[1:] ** 2).sum()
        )

    return Weights(*minimize(loss, np.zeros(X.shape[1])).x.tolist())


class Score(NamedTuple):
    """Objects left, those found, places, those that are wrong, and squared errors (m2) in objects: all, in places."""

    objects: int
    found: int
    places: int
    false: int
    squared: float
    in_places: float


def scored(sample: Sample, weights: Weights) -> Score:
    """The first places of a scene against the truth."""
    places = chosen(sample.found, sample.levels, chances(sample.measures, weights))[:FIRST]
    taken = np.zeros(sample.error.shape, np.bool_)
    for _, cells, box in places:
        taken[box] |= cells
    error = np.nan_to_num(sample.error)
    numbers, n = ndimage.label(error > HIGH_M, TOUCHING)
    sizes = np.bincount(numbers.ravel(), minlength=n + 1) * sample.cell_m**2
    objects = 1 + np.flatnonzero(sizes[1:] >= AREA_M2)
    covered = ndimage.mean(taken, numbers, objects) if objects.size else np.zeros(0)
    judged = [i for i, *_ in places if sample.is_known[i]]
    left = np.isin(numbers, objects)
    return Score(
        objects.size,
        int((np.asarray(covered) >= COVERED).sum()),
        len(judged),
        sum(not sample.is_right[i] for i in judged),
        float((error[left] ** 2).sum()),
        float((error[left & taken] ** 2).sum()),
    )


def report(samples: Sequence[Sample]) -> str:
    """Each scene with the weights of the others, their sum, and the weights of all, as Markdown."""
    scores = {
        sample.name: scored(sample, fitted([s for s in samples if s is not sample]))
        for sample in samples
    }
    scores["all"] = Score(*(sum(column) for column in zip(*scores.values(), strict=True)))
    names = [
        "scene",
        "objects left",
        "found",
        "places",
        "false",
        "squared error m2",
        "in places",
    ]
    rows = [
        [name, *map(str, s[:4]), f"{s.squared:.0f}", f"{s.in_places:.0f}"]
        for name, s in scores.items()
        if s.objects or s.places
    ]
    return f"{table(names, rows)}\n{fitted(samples)}\n"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run, fit, print."""
    parser = argparse.ArgumentParser(description="Fit the constants of objects left.")
    parser.add_argument("folder", type=Path, help="folder for the runs")
    parser.add_argument("--scenes", help="only these, with commas")
    parser.add_argument("--seeds", default="900,950,990", help="first seeds of other sites")
    given = parser.parse_args(arguments)
    known = [scene for scene in known_scenes(DATA) if scene.kind == "als"]
    for seed in filter(None, given.seeds.split(",")):
        known += other_scenes(int(seed))
    only = given.scenes.split(",") if given.scenes else None
    print(report([sampled(k, given.folder) for k in known if only is None or k.name in only]))


if __name__ == "__main__":
    main()
