"""Facts in run.json on the pixels inside the survey that have no height."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np
import scipy

from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.raster import Block, RasterSpec
from tiler.grid import CELL_PIXELS
from tiler.runs.job import Job
from tiler.store import Commits

MAX_LISTED = 1000
"""Largest number of voids in run.json, which lists the largest voids."""
TOUCHING = 1.5
"""Largest distance between the centres of touching cells: longer than a diagonal, shorter than two cells."""


def report_voids(job: Job, spec: RasterSpec, outlined: Commits) -> None:
    """Add to run.json the voids of the delivered terrain, and the holes inside each edit."""
    records = [record for _, record in outlined.values()]
    inside: Counter[int] = Counter()
    for record in records:
        inside.update(dict(map(tuple, record["edit_holes"])))
    for fact in job.facts.get("edits", ()):
        fact["holes"] = inside[fact["number"]]
    voids_in_pixels = voids_of((cell for record in records for cell in record["holes"]), spec)
    square = float(job.plan.resolution) ** 2
    voids = [{**void, "area_m2": void["pixels"] * square} for void in voids_in_pixels]
    job.facts["voids"] = {
        "surveyed_pixels": sum(record["surveyed"] for record in records),
        "pixels": sum(void["pixels"] for void in voids),
        "asked_pixels": sum(record["voided"] for record in records),
        "number": len(voids),
        "largest": voids[:MAX_LISTED],
    }


def voids_of(cells: Iterable[list[int]], spec: RasterSpec) -> list[dict[str, Any]]:
    """Merge holes whose cells touch. Return voids with ``pixels`` and CRS ``bounds``, the largest first."""
    table = np.array(list(cells), np.int64).reshape(-1, 5)
    if not len(table):
        return []
    pairs = scipy.spatial.cKDTree(table[:, 1:3] // CELL_PIXELS).query_pairs(TOUCHING, output_type="ndarray")
    graph = scipy.sparse.coo_array((np.ones(len(pairs)), pairs.T), (len(table), len(table)))
    count, number = scipy.sparse.csgraph.connected_components(graph, directed=False)
    pixels = np.bincount(number, table[:, 0], count).astype(np.int64)
    first, last = np.full((count, 2), np.iinfo(np.int64).max), np.zeros((count, 2), np.int64)
    np.minimum.at(first, number, table[:, 1:3])
    np.maximum.at(last, number, table[:, 3:])
    order = np.lexsort((first[:, 1], first[:, 0], -pixels))
    return [{"pixels": int(pixels[i]), "bounds": _bounds(spec, first[i], last[i])} for i in order]


def _bounds(spec: RasterSpec, first: Any, last: Any) -> list[float]:
    height, width = (last - first + 1).tolist()
    bounds = spec.block_bounds(Block(int(first[0]), int(first[1]), height, width))
    return [edge / COUNTS_PER_UNIT for edge in bounds.to_json()]
