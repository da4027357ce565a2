"""Checks without checkpoints: steps of a DTM across the edges of tiles, and differences of overlapping flight strips.

Steps across edges are compared with steps within tiles. A *step* is the absolute difference of two neighbouring pixels.
A *jump* is the part of a step that the slopes on both sides do not explain. For heights a, b, c, d in a row, the jump
between b and c is |(c - b) - ((b - a) + (d - c)) / 2|. It is 0 on any plane and any parabola, so it shows a seam on
steep ground as well.

A few edges cross only a small part of the terrain, which may be rougher than the rest. So edges are compared with the
lines of pixels next to them, which cross the same terrain.

Strips are distinguished by the point source ids of their points.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy.ndimage import maximum_filter1d

from ptd.arrays import Bool, Float64, Int64
from tiler.apps.difference_statistics import spread, summed
from tiler.apps.evaluate.rasters import (
    blocks_with_files,
    horizontal_unit,
    open_raster,
    read_heights,
    vertical_unit,
)
from tiler.apps.results import Seams, Steps, StripPair, Strips
from tiler.core.points import GROUND, WITHHELD_FLAG
from tiler.core.raster import BLOCK_PIXELS
from tiler.core.units import METRE, unit_label, unit_named
from tiler.errors import ConfigError, InputError
from tiler.inputs import find_inputs, inspect
from tiler.io.foreign_content import parse_json_object
from tiler.io.las.headers import read_header
from tiler.io.las.point_formats import class_and_flags, coordinate
from tiler.io.las.reader import EVERYTHING, PointReader
from tiler.io.locations import as_path
from tiler.io.result_folder import RUN
from tiler.schedule import call_isolated, half_of_memory

BESIDE = (3, 20)
"""Minimum and maximum distance, in pixels from an edge, of the lines of pixels with which the edge is compared.

Nearer lines are left out, because the slopes next to the edge contain half of its jump.
"""

KINDS = ("interior", "tiles", "blocks", "beside_tiles", "beside_blocks")
"""Kinds of steps: within tiles, across edges, and next to edges.

The edges are those of tiles and of the raster's own blocks.
"""


@dataclass(frozen=True)
class TileEdges:
    """Edges of tiles, at multiples of a size, moved to the nearest edge of a bucket.

    Attributes
    ----------
    tile : float
        Side of a tile in units of the CRS. The lattice is anchored at coordinate 0.
    bucket : float
        Side of a bucket in units of the CRS. A tile consists of the buckets whose centres lie in its cell. 0: there
        are no buckets, and edges are not moved.
    blocks : bool
        Whether to examine the raster's own blocks as well.
    """

    tile: float
    bucket: float = 0.0
    blocks: bool = False

    def between(self, low: float, high: float) -> list[float]:
        """Return the edges in an open interval along one axis, sorted."""
        first, last = math.ceil(low / self.tile) - 1, math.floor(high / self.tile) + 1
        edges = [k * self.tile for k in range(first, last + 1)]
        if self.bucket:
            edges = [math.ceil(edge / self.bucket - 0.5) * self.bucket for edge in edges]
        return sorted({edge for edge in edges if low < edge < high})


@dataclass
class StepStatistics:
    """Number, sums and maximum of the values that are not NaN."""

    n: int = 0
    total: float = 0.0
    squares: float = 0.0
    largest: float = 0.0

    def add(self, values: Float64) -> None:
        """Add the values that are not NaN."""
        known = values[np.isfinite(values)]
        if known.size:
            self.n += known.size
            self.total += float(known.sum())
            self.squares += float((known**2).sum())
            self.largest = max(self.largest, float(known.max()))

    @property
    def mean_and_largest(self) -> tuple[float | None, float | None]:
        """Mean and largest value, both None if there are no values."""
        return (self.total / self.n, self.largest) if self.n else (None, None)

    @property
    def standard_error(self) -> float:
        """Standard error of the mean, as if the values were independent. Infinite for fewer than two values."""
        if self.n < 2:
            return math.inf
        variance = max(self.squares - self.total**2 / self.n, 0.0) / (self.n - 1)
        return math.sqrt(variance / self.n)


def seam_steps(dtm: Path | str, edges: TileEdges) -> Seams:
    """Measure steps and jumps across edges and within tiles, block by block.

    Parameters
    ----------
    dtm : path
        Raster without rotation.
    edges : TileEdges

    Raises
    ------
    InputError
        The DTM cannot be read.
    ConfigError
        The DTM is rotated, or the tiles are narrower than four pixels.
    """
    with open_raster(dtm) as raster:
        if raster.transform.b or raster.transform.d:
            raise ConfigError(f"{dtm} is rotated; seams need rows and columns along the axes")
        if edges.tile < 4 * max(abs(raster.transform.a), abs(raster.transform.e)):
            raise ConfigError(f"--tile-size {edges.tile:g}: must be four pixels at least")
        metres, horizontal_metres = vertical_unit(raster), horizontal_unit(raster)
        tallies = {
            name: (StepStatistics(), StepStatistics())
            for name in ("interior", "tiles", "beside_tiles")
        }
        for steps, jumps, marks in _pairs(raster, edges):
            for name, mark in marks.items():
                of_steps, of_jumps = tallies.setdefault(
                    name, (StepStatistics(), StepStatistics())
                )
                of_steps.add(steps[mark])
                of_jumps.add(jumps[mark])
    found = {name: _steps(*tallies[name]) for name in KINDS if name in tallies}
    near = "beside_tiles" if found["beside_tiles"]["pairs"] else "interior"
    across, beside = found["tiles"]["mean_jump"], found[near]["mean_jump"]
    excess = None if across is None or beside is None else across - beside
    error = math.hypot(*(tallies[name][1].standard_error for name in ("tiles", near)))
    seams = {
        "unit": unit_label(metres),
        "metres_per_unit": float(metres),
        "horizontal_metres_per_unit": float(horizontal_metres),
        "tile": edges.tile,
        "bucket": edges.bucket,
        **found,
        "excess": excess,
        "excess_error": None if math.isinf(error) else error,
    }
    return cast(Seams, seams)


def _steps(steps: StepStatistics, jumps: StepStatistics) -> Steps:
    mean_step, largest_step = steps.mean_and_largest
    mean_jump, largest_jump = jumps.mean_and_largest
    return {
        "pairs": steps.n,
        "mean_step": mean_step,
        "largest_step": largest_step,
        "mean_jump": mean_jump,
        "largest_jump": largest_jump,
    }


def seams_of(dtm: Path | str, tile_m: Fraction | None) -> Seams | None:
    """Return `seam_steps` for tiles of a size in metres, or for the tiles of the run that made the DTM.

    Parameters
    ----------
    dtm : path
    tile_m : Fraction or None
        Side of a tile in metres. None: the tiles in the ``run.json`` next to the DTM.

    Returns
    -------
    Seams or None
        Result of `seam_steps`, or None without a size and without a ``run.json``.

    Raises
    ------
    TilerError
        `seam_steps` or `edges_of_run` raises it, the DTM cannot be read, or ``tile_m`` is not positive.
    """
    with open_raster(as_path(dtm)) as raster:
        metres = horizontal_unit(raster)
    if tile_m is None:
        edges = edges_of_run(as_path(dtm))
        return None if edges is None else seam_steps(dtm, edges)
    if tile_m <= 0:
        raise ConfigError(f"--tile-size {tile_m}: must be above 0")
    return seam_steps(dtm, TileEdges(float(tile_m / metres)))


def _pairs(raster: Any, edges: TileEdges) -> Iterator[tuple[Float64, Float64, dict[str, Bool]]]:
    """Yield steps and jumps of neighbouring pixels, and masks of their kinds.

    Each block yields the neighbours along rows, then along columns. Values next to pixels
    without data are NaN.
    """
    transform, (height, width) = raster.transform, raster.shape
    columns = _marks(transform.c, transform.a, width, edges)
    rows = _marks(transform.f, transform.e, height, edges)
    for row, col, high, wide in blocks_with_files(raster):
        along = read_heights(raster, row, col - 2, high, wide + 3)
        yield _differences(along, {k: m[col : col + wide] for k, m in columns.items()})
        down = read_heights(raster, row - 2, col, high + 3, wide).T
        yield _differences(down, {k: m[row : row + high] for k, m in rows.items()})


def _differences(
    heights: Float64, marks: dict[str, Bool]
) -> tuple[Float64, Float64, dict[str, Bool]]:
    """Return steps and jumps between columns i + 1 and i + 2 of ``heights``, and masks of their kinds.

    The results have three columns fewer than ``heights``.
    """
    a, b, c, d = heights[:, :-3], heights[:, 1:-2], heights[:, 2:-1], heights[:, 3:]
    steps = np.abs(c - b)
    jumps = np.abs((c - b) - ((b - a) + (d - c)) / 2)
    return (
        steps,
        jumps,
        {name: np.broadcast_to(mark, steps.shape) for name, mark in marks.items()},
    )


def _marks(start: float, size: float, pixels: int, edges: TileEdges) -> dict[str, Bool]:
    """Return, for each kind of step, a mask of the pixels along an axis with such a step from the previous pixel."""
    low, high = sorted((start, start + size * pixels))
    edge_mask = np.zeros(pixels + 1, np.bool_)
    for edge in edges.between(low, high):
        # In the order of the file, this is the first pixel whose centre lies on or beyond the
        # edge.
        position = (edge - start) / size - 0.5
        edge_mask[min(math.ceil(position - 1e-9), pixels)] = True
    edge_mask[0] = False
    marks = {"tiles": edge_mask[:pixels]}
    if edges.blocks:
        at = np.arange(pixels)
        marks["blocks"] = (at % BLOCK_PIXELS == 0) & (at > 0)
    close = np.any([_within(BESIDE[0] - 1, mark) for mark in marks.values()], axis=0)
    beside = {
        f"beside_{name}": _within(BESIDE[1], mark) & ~close for name, mark in marks.items()
    }
    return {"interior": ~np.any(list(marks.values()), axis=0), **marks, **beside}


def _within(lines: int, mark: Bool) -> Bool:
    """Return a mask of the lines that are at most ``lines`` lines away from a marked line."""
    return maximum_filter1d(mark.astype(np.uint8), 2 * lines + 1, mode="constant") > 0


def edges_of_run(dtm: Path) -> TileEdges | None:
    """Return the edges of the run that made a DTM, or None if no ``run.json`` is next to it.

    Raises
    ------
    InputError
        The ``run.json`` cannot be read, or does not contain the sizes of tiles and buckets.
    """
    path = dtm.parent / RUN
    if not path.is_file():
        return None
    try:
        plan = parse_json_object(path.read_text("utf-8"))["plan"]
        metres = float(unit_named(plan["units"]["horizontal"]))
        tile, bucket = plan["tile_m"] / metres, plan["bucket_m"] / metres
        if not (0 < bucket < math.inf and 0 < tile < math.inf):
            raise ValueError(f"tiles of {tile}, buckets of {bucket}")
        return TileEdges(tile, bucket, blocks=True)
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        OverflowError,
        ConfigError,
    ) as error:
        raise InputError(
            f"{path} is not of a run of this version ({error!r}); give --tile-size"
        ) from error


CELL_M = 2.0
"""Side of the compared cells in metres.

They are large enough for a few points of each strip, and small enough to be nearly flat.
"""
MIN_POINTS = 3
"""Minimum number of points of each strip in a compared cell."""
MAX_ROUGH_M = 0.1
"""Maximum standard deviation of a strip's heights in a compared cell, metres.

Other cells are too rough or too steep.
"""


def strip_differences(clouds: Sequence[str | Path]) -> Strips:
    """Compare the ground heights of strips in the cells of 2 m that they share.

    The files are read piece by piece. Memory grows with the number of cells that contain
    ground.

    Parameters
    ----------
    clouds : sequence of path
        Files, folders, globs, all of one CRS, with class 2 for ground.

    Raises
    ------
    InputError
        A file cannot be read, or there is no ground.
    """
    paths = find_inputs(clouds, results=True)
    return call_isolated(_strips_of, paths, paths=paths, memory_bytes=half_of_memory())


def _strips_of(paths: Sequence[Path]) -> Strips:
    place = inspect(paths[0]).georeference
    horizontal = place.horizontal or METRE
    vertical = place.vertical or horizontal
    keys, sums = np.empty((3, 0), np.int64), np.empty((3, 0))
    strips: dict[int, int] = {}
    for path in paths:
        for source, x, y, z in _ground(path):
            for strip, points in zip(*np.unique(source, return_counts=True), strict=True):
                strips[int(strip)] = strips.get(int(strip), 0) + int(points)
            side = CELL_M / float(horizontal)
            cells = (source, *(np.floor(place / side).astype(np.int64) for place in (x, y)))
            keys = np.concatenate((keys, np.stack(cells)), axis=1)
            sums = np.concatenate((sums, np.stack((np.ones(z.size), z, z**2))), axis=1)
            keys, sums = summed(keys, sums)
    if not strips:
        raise InputError(
            f"{paths[0]}: no ground (class 2) in {len(paths)} files; give classified clouds, as `tiler run` writes them"
        )
    rough, difference, pairs = _compared(keys, sums, MAX_ROUGH_M / float(vertical))
    return {
        "unit": unit_label(vertical),
        "metres_per_unit": float(vertical),
        "cell_m": CELL_M,
        "strips": {str(strip): strips[strip] for strip in sorted(strips)},
        "cells": int(difference.size),
        "rough": rough,
        "all": spread(difference),
        "pairs": pairs,
    }


def _ground(path: Path) -> Iterator[tuple[Int64, Float64, Float64, Float64]]:
    """Yield source ids and coordinates of the ground points of a file, piece by piece."""
    header = read_header(path)
    with PointReader(header, EVERYTHING) as reader:
        for records in reader.pieces():
            classes, flags = class_and_flags(records, header.point_format)
            records = records[(classes == GROUND) & ((flags & WITHHELD_FLAG) == 0)]
            x, y, z = (coordinate(records, header, axis) for axis in range(3))
            yield records["point_source_id"].astype(np.int64), x, y, z


def _compared(
    keys: Int64, sums: Float64, max_rough: float
) -> tuple[int, Float64, list[StripPair]]:
    """Return the number of rough comparisons, all differences of strips in the cells that they share, and each pair's.

    The rows of ``keys`` are strip, column and row, sorted by row, column and strip. The rows of
    ``sums`` are the number of points, the sum of their heights, and the sum of their squared
    heights.
    """
    n, total, squares = sums
    mean = total / n
    deviation = np.sqrt(np.maximum(squares / n - mean**2, 0.0))
    fit = (n >= MIN_POINTS) & (deviation <= max_rough)
    firsts, seconds = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    rough, step = 0, 1
    while True:
        # Strips of a cell are consecutive, so the strips of a pair are ``step`` apart.
        same = np.all(keys[1:, step:] == keys[1:, :-step], axis=0)
        if not same.any():
            break
        usable = same & fit[step:] & fit[:-step]
        rough += int(same.sum() - usable.sum())
        firsts.append(np.flatnonzero(usable))
        seconds.append(firsts[-1] + step)
        step += 1
    first, second = np.concatenate(firsts), np.concatenate(seconds)
    difference = mean[second] - mean[first]
    of_first, of_second = keys[0, first], keys[0, second]
    by_pair = {
        (a, b): difference[(of_first == a) & (of_second == b)]
        for a, b in sorted(set(zip(of_first.tolist(), of_second.tolist(), strict=True)))
    }
    pairs: list[StripPair] = [
        {"first": a, "second": b, "cells": int(found.size), **spread(found)}
        for (a, b), found in by_pair.items()
    ]
    return rough, difference, pairs
