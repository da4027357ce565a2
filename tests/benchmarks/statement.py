"""How often the statement of `tiler review --statement` is true, if the true terrain gives the answers.

``python -m tests.benchmarks.statement [--surveys 60] [--runs FOLDER --scenes als_city,city_900 --seeds 900]``

Surveys are random hills with boxes of 1 to 8 m. With ``--runs``, the laser scans of `tests.benchmarks.left_objects`
are filtered and gridded, too; the runs stay in FOLDER. An outlined pixel is an object if the terrain is `OBJECT_M`
above the true one. Objects wider than the square of the opening do not count, as the statement says. Each survey is
stopped after `STOPS` draws. Markdown goes to the standard output.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rasterio
from scipy import ndimage

from tests.benchmarks.left_objects import other_scenes
from tests.benchmarks.scorecard import DATA
from tests.benchmarks.scorecard_text import table
from tests.benchmarks.sigma_scenes import CORNER, known_scenes, placed, ran
from tests.tiler.apps.check.rasters import write_heights
from tiler.apps.statement.sample import sample_of
from tiler.apps.statement.squares import OPENING_M, Terrain, half_side
from tiler.apps.statement.writing import OBJECT_M
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.raster import NODATA, Block, RasterSpec
from tiler.store import open_store

STOPS = (30, 100)
SIDE, BOXES = 600, 25
ROUGH_M = 0.05


class Judged(NamedTuple):
    """Areas in pixels of a survey: all, rising, objects, and the bounds after the `STOPS`."""

    name: str
    pixels: int
    rising: int
    objects: int
    bounds: tuple[float, ...]

    @property
    def is_true(self) -> bool:
        return all(self.objects <= bound for bound in self.bounds)


def artificial(seed: int, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Heights of random hills with boxes and a void, and their true heights, in pixels of 1 m."""
    rng = np.random.default_rng(seed)
    row, col = np.indices((side, side))
    truth = np.full((side, side), 300.0)
    for _ in range(6):
        length, angle, phase = rng.uniform(80, 600), *rng.uniform(0, 2 * np.pi, 2)
        along = col * np.cos(angle) + row * np.sin(angle)
        truth += rng.uniform(0, 0.02) * length * np.sin(2 * np.pi * along / length + phase)
    truth += rng.normal(0, ROUGH_M, truth.shape)
    heights, is_taken = truth.copy(), np.zeros(truth.shape, bool)
    for _ in range(int(rng.integers(0, BOXES))):
        high, wide = rng.integers(2, 36, 2)
        top, left = rng.integers(20, side - 56, 2)
        near = slice(top - 5, top + high + 5), slice(left - 5, left + wide + 5)
        # Boxes that touch each other may be wider than the statement regards.
        if not is_taken[near].any():
            is_taken[near] = True
            heights[top : top + high, left : left + wide] += rng.uniform(OBJECT_M, 8)
    heights[side // 2 : side // 2 + 30, 50 : side // 2] = np.nan
    return heights.astype(np.float32), truth


def objects_in(heights: np.ndarray, truth: np.ndarray, pixel_m: float) -> np.ndarray:
    """Which pixels are objects, without those of parts that are wider than the square of the opening."""
    with np.errstate(invalid="ignore"):
        is_object = heights - truth >= OBJECT_M
    side = 2 * half_side(OPENING_M, pixel_m) + 1
    return is_object & ~ndimage.binary_opening(is_object, np.ones((side, side)))


def judged(
    name: str, heights: np.ndarray, truth: np.ndarray, pixel_m: float, folder: Path
) -> Judged:
    """The bounds of a survey of which the true heights answer draw by draw."""
    is_object = objects_in(heights, truth, pixel_m)
    values = np.nan_to_num(heights, nan=NODATA)
    with rasterio.open(write_heights(folder / "dtm.tif", values, size=pixel_m)) as raster:
        terrain = Terrain(raster, pixel_m, 1.0)
        squares = terrain.squares()
        rises, is_there = terrain.rising(0, 0, *heights.shape)
    key, side = squares.digest(name), squares.side
    bounds, answers = [], {}
    for draw in range(1, max(STOPS) + 1):
        if not squares.rising.size:
            bounds = [0.0] * len(STOPS)
            break
        index = squares.drawn(key, draw)
        row, col = squares.row[index] * side, squares.col[index] * side
        window = slice(row, row + side), slice(col, col + side)
        share = (is_object & rises)[window].sum() / squares.rising[index]
        answers[draw] = np.ceil(4 * share) / 4
        if draw in STOPS:
            bounds.append(sample_of(squares, key, answers, 1).max_pixels)
    return Judged(
        name, int(is_there.sum()), int(rises.sum()), int(is_object.sum()), tuple(bounds)
    )


def artificial_surveys(number: int, side: int = SIDE) -> Iterator[Judged]:
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(number):
            yield judged(f"hills {seed}", *artificial(seed, side), 1.0, Path(folder))


def runs(folder: Path, names: str, seeds: str) -> Iterator[Judged]:
    """Runs of laser scans whose terrain is known."""
    scenes = [known for known in known_scenes(DATA) if known.kind == "als"]
    scenes += [known for seed in seeds.split(",") if seed for known in other_scenes(int(seed))]
    for known in scenes:
        if names and known.name not in names.split(","):
            continue
        store = open_store(str(ran(known, folder) / "store.zarr"))
        spec = RasterSpec.from_json(store.get_state("raster-dtm-outlined"))
        block = Block(0, 0, spec.height, spec.width)
        values = store.read_block("dtm-outlined", block).astype(np.float64)
        x, y = (
            centres / COUNTS_PER_UNIT - corner
            for centres, corner in zip(spec.centres(block), CORNER, strict=True)
        )
        truth = placed(known.scene).truth
        assert truth is not None
        heights = np.where(values == np.float32(NODATA), np.nan, values)
        pixel_m = float(spec.lattice.size * store.meta.frame.metres_xy)
        yield judged(known.name, heights, truth(x, y), pixel_m, folder)


def text_of(surveys: list[Judged]) -> str:
    rows = [
        [s.name, f"{s.pixels:,}", f"{s.rising:,}", f"{s.objects:,}"]
        + [f"{bound:,.0f}" for bound in s.bounds]
        + ["yes" if s.is_true else "no"]
        for s in surveys
    ]
    head = ["survey", "pixels", "rising", "objects", *(f"after {n}" for n in STOPS), "true"]
    number = sum(s.is_true for s in surveys)
    return f"{table(head, rows)}\n\n{number} of {len(surveys)} are true.\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--surveys", type=int, default=60)
    parser.add_argument("--runs", type=Path)
    parser.add_argument("--scenes", default="")
    parser.add_argument("--seeds", default="900")
    options = parser.parse_args()
    if options.surveys:
        print(text_of(list(artificial_surveys(options.surveys))))
    if options.runs is not None:
        print(text_of(list(runs(options.runs, options.scenes, options.seeds))))


if __name__ == "__main__":
    main()
