"""Height differences of overlapping flight strips, which their point source ids distinguish."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tiler.apps.cell_sums import summed
from tiler.apps.check.results import ComparedStrips, StripPair, Strips
from tiler.core.classes import GROUND, WITHHELD_FLAG
from tiler.core.difference_statistics import spread
from tiler.core.units import METRE, unit_label
from tiler.errors import InputError
from tiler.inputs import find_inputs, inspect
from tiler.io.las.headers import read_header
from tiler.io.las.point_formats import class_and_flags, coordinate
from tiler.io.las.reader import EVERYTHING, PointReader
from tiler.schedule import call_isolated, half_of_memory

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

Floats = npt.NDArray[np.float64]
Int64s = npt.NDArray[np.int64]


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
    return {
        "unit": unit_label(vertical),
        "metres_per_unit": float(vertical),
        "cell_m": CELL_M,
        "strips": {str(strip): strips[strip] for strip in sorted(strips)},
        **_compared(keys, sums, MAX_ROUGH_M / float(vertical)),
    }


def _ground(path: Path) -> Iterator[tuple[Int64s, Floats, Floats, Floats]]:
    """Yield source ids and coordinates of the ground points of a file, piece by piece."""
    header = read_header(path)
    with PointReader(header, EVERYTHING) as reader:
        for records in reader.pieces():
            classes, flags = class_and_flags(records, header.point_format)
            records = records[(classes == GROUND) & ((flags & WITHHELD_FLAG) == 0)]
            x, y, z = (coordinate(records, header, axis) for axis in range(3))
            yield records["point_source_id"].astype(np.int64), x, y, z


def _compared(keys: Int64s, sums: Floats, max_rough: float) -> ComparedStrips:
    """Return the differences of all pairs of strips in the cells that they share.

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
    pairs: list[StripPair] = []
    for a, b in sorted(set(zip(of_first.tolist(), of_second.tolist(), strict=True))):
        pair_differences = difference[(of_first == a) & (of_second == b)]
        pairs.append(
            {
                "first": a,
                "second": b,
                "cells": int(pair_differences.size),
                **spread(pair_differences),
            }
        )
    return {
        "cells": int(difference.size),
        "rough": rough,
        "all": spread(difference),
        "pairs": pairs,
    }
