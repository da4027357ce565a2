"""Entries in run.json about the pixels inside the survey that have no height."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.raster import Block, RasterSpec
from tiler.core.terrain_results import VoidResult, VoidsResult
from tiler.grid.tasks.gridding import GridContext
from tiler.grid.voids import CELL_PIXELS
from tiler.runs.job import Job
from tiler.store import Commits

MAX_LISTED = 1000
"""run.json lists at most this many voids, the largest ones."""
MIN_BARE_CELLS = 2
"""Least side in cells of the survey of a square with the area of a place without returns."""
TOUCHING = 1.5
"""Cells touch if their centres are at most this far apart, in cells. Diagonal neighbours touch,
too."""


def report_voids(job: Job, gridding: GridContext, outlined: Commits) -> None:
    """Add to run.json the voids of the delivered terrain, places without returns, and the holes inside each edit."""
    of_blocks, spec = [counts for _, counts in outlined.values()], gridding.spec
    hole_pixels: Counter[int] = Counter()
    for counts in of_blocks:
        for edit, n_pixels in counts["edit_holes"]:
            hole_pixels[edit] += n_pixels
    if job.results.edits:
        job.results.edits = [
            replace(edit, holes=hole_pixels[edit.number]) for edit in job.results.edits
        ]
    cells = chain.from_iterable(counts["holes"] for counts in of_blocks)
    pixel_m2 = float(job.plan.grid.resolution) ** 2
    voids = voids_of(cells, spec, pixel_m2)
    job.results.voids = VoidsResult(
        surveyed_pixels=sum(counts["surveyed"] for counts in of_blocks),
        pixels=sum(void.pixels for void in voids),
        asked_pixels=sum(counts["voided"] for counts in of_blocks),
        number=len(voids),
        largest=voids[:MAX_LISTED],
    )
    bare = chain.from_iterable(counts["bare"] for counts in of_blocks)
    # What water or the border leaves of a place may be smaller.
    min_m2 = (MIN_BARE_CELLS * float(gridding.coarse_m)) ** 2
    places = [p for p in voids_of(bare, spec, pixel_m2) if p.area_m2 >= min_m2]
    job.results.without_returns = places[:MAX_LISTED]


def voids_of(cells: Iterable[list[int]], spec: RasterSpec, pixel_m2: float) -> list[VoidResult]:
    """Merge touching cells with holes (see `tiler.grid.voids.hole_cells`) into voids, the largest first."""
    table = np.array(list(cells), np.int64).reshape(-1, 8)
    if not len(table):
        return []
    n_holes, first_pixel, last_pixel = table[:, 0], table[:, 1:3], table[:, 3:5]
    pairs = scipy.spatial.cKDTree(first_pixel // CELL_PIXELS).query_pairs(
        TOUCHING, output_type="ndarray"
    )
    graph = scipy.sparse.coo_array((np.ones(len(pairs)), pairs.T), (len(table), len(table)))
    n_voids, void_of_cell = scipy.sparse.csgraph.connected_components(graph, directed=False)
    pixels = np.bincount(void_of_cell, n_holes, n_voids).astype(np.int64)
    at_border = np.bincount(void_of_cell, table[:, 5], n_voids) > 0
    first = np.full((n_voids, 2), np.iinfo(np.int64).max)
    last = np.zeros((n_voids, 2), np.int64)
    np.minimum.at(first, void_of_cell, first_pixel)
    np.maximum.at(last, void_of_cell, last_pixel)
    at = table[_central_cells(void_of_cell, n_holes, table[:, 6:]), 6:]
    order = np.lexsort((first[:, 1], first[:, 0], -pixels))
    return [
        VoidResult(
            int(pixels[i]),
            _bounds(spec, first[i], last[i]),
            int(pixels[i]) * pixel_m2,
            bool(at_border[i]),
            _centre(_bounds(spec, at[i], at[i])),
        )
        for i in order
    ]


def _central_cells(
    void_of_cell: Any, n_holes: Any, positions: npt.NDArray[np.int64]
) -> npt.NDArray[np.intp]:
    """Return for each void its cell with most holes, of several the one next to their mean."""
    most = np.zeros(void_of_cell.max() + 1, np.int64)
    np.maximum.at(most, void_of_cell, n_holes)
    is_full = n_holes == most[void_of_cell]
    n_full = np.bincount(void_of_cell, is_full)
    means = np.stack(
        [np.bincount(void_of_cell, is_full * values) / n_full for values in positions.T]
    )
    from_mean = np.hypot(*(positions.T - means[:, void_of_cell]))
    best_first = np.lexsort(
        (positions[:, 1], positions[:, 0], from_mean, ~is_full, void_of_cell)
    )
    return best_first[np.searchsorted(void_of_cell[best_first], np.arange(len(most)))]


def _centre(bounds: list[float]) -> list[float]:
    west, south, east, north = bounds
    return [(west + east) / 2, (south + north) / 2]


def _bounds(spec: RasterSpec, first: Any, last: Any) -> list[float]:
    height, width = (last - first + 1).tolist()
    bounds = spec.block_bounds(Block(int(first[0]), int(first[1]), height, width))
    return [edge / COUNTS_PER_UNIT for edge in bounds.to_json()]
