"""Filtering of one tile in one pass: fit a model to core and halo, then label or elect points in the core."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from ptd.arrays import UInt8
from ptd.frame import OPEN, Scale, Window
from ptd.methods import METHODS
from ptd.passes import Model, Pass, Points, joined
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.points import GROUND, LOW_NOISE, UNCERTIFIED_BIT, UNCLASSIFIED
from tiler.core.records import TileRecord, digest_of_arrays
from tiler.filter.reading import FilterTile, TileReader
from tiler.store import TileStore

KEPT_LABEL = 0
"""Label of a point that does not take part in filtering and keeps the class of its source."""

REACH_CELLS = 4
"""A side of a window is open if no bucket lies within this many cells beyond the side.

The cells are those of the method's lattice.
"""


def influence_margin_m(step: Pass, params: Any) -> float:
    """Return the distance in metres beyond the halo within which buckets can affect a tile.

    ``params`` are the parameters of the method.
    """
    if step.influence_radius_m is not None:
        return 0.0
    return float((REACH_CELLS + 1) * params.align_m + params.margin_m)


def filter_tile(store: TileStore, *, work: FilterTile) -> TileRecord:
    """Filter one tile.

    A core with uncertified labels or statistics is repeated with twice the halo, up to
    ``max_halo``. Labels that stay uncertified keep bit 7 and are counted.

    Returns
    -------
    TileRecord
        Record of the tile.
    """
    params = METHODS[work.method].params(**work.parameters)
    step = params.passes[work.number]
    scale = Scale(
        store.meta.frame.metres_xy, store.meta.frame.metres_z, store.meta.frame.origin
    )
    core = store.meta.bucket.hull(work.cells)
    local_core = _local(core, store)
    reader = TileReader(store, step, work)
    halo, tries, area = work.halo, 0, 0
    while True:
        tries += 1
        window, known = _window(store, core.pad(halo), step, params)
        area += window.area()
        points, inputs_uncertified = reader.window(window, params.candidate_cell_m)
        model = step.fit(points, known, local_core, scale, work.state)
        labels = {}
        for cell in work.cells if step.gives_labels else ():
            if step.elects:
                labels[cell] = _label_elected(store, cell, model)
                continue
            labels[cell], near_uncertified = _label(reader, cell, model)
            inputs_uncertified |= near_uncertified
        n_uncertified = sum(
            int(np.count_nonzero(cell_labels & UNCERTIFIED_BIT))
            for cell_labels in labels.values()
        )
        if (n_uncertified == 0 and model.uncertain() == 0) or halo >= work.max_halo:
            break
        halo = min(2 * halo, work.max_halo)
        del points, model  # This frees memory for the wider window.
    # Uncertified labels of an earlier pass may have changed any of these labels.
    if inputs_uncertified:
        labels = {
            cell: cell_labels | (cell_labels > 0) * np.uint8(UNCERTIFIED_BIT)
            for cell, cell_labels in labels.items()
        }
        n_uncertified = sum(
            int(np.count_nonzero(cell_labels)) for cell_labels in labels.values()
        )
    elected, elected_points = _elect(store, work.cells, model, work.elected_out)
    for cell, cell_labels in labels.items():
        if work.labels_elected or step.elects:
            store.write_elected_labels(work.labels_out, cell, cell_labels)
        else:
            store.write_labels(work.labels_out, cell, cell_labels, work.candidates_only)
    counts = np.zeros(256, np.int64)
    for cell_labels in labels.values():
        counts += np.bincount(cell_labels & ~np.uint8(UNCERTIFIED_BIT), minlength=256)
    return TileRecord(
        points=int(counts.sum()),
        ground=int(counts[GROUND]),
        low_noise=int(counts[LOW_NOISE]),
        unclassified=int(counts[UNCLASSIFIED]),
        kept=int(counts[KEPT_LABEL]),
        marked=n_uncertified,
        tries=tries,
        halo=halo,
        window_points=len(points),
        core_area=core.area(),
        window_area=area,
        cells=[[cell.ix, cell.iy] for cell in work.cells],
        labels=digest_of_arrays(*labels.values()),
        elected=elected,
        elected_points=elected_points,
        partial=model.partial(),
        stats=model.stats,
    )


def _label(reader: TileReader, cell: Cell, model: Model) -> tuple[UInt8, bool]:
    """Return the labels of the points of a bucket, and whether a label around the bucket was uncertified.

    Uncertified labels have bit 7. Points that do not take part in filtering are not passed to
    the model. Points at the position of another point get its label.
    """
    bucket = reader.bucket(cell)
    points_around, near_uncertified = reader.points_around(cell)
    bucket_labels = np.full(bucket.mask.size, KEPT_LABEL, np.uint8)
    n = len(bucket.points)
    if n:
        points = joined([bucket.points, *points_around]) if points_around else bucket.points
        labels, uncertified = model.label(points)
        bits = uncertified[:n].astype(np.uint8) * np.uint8(UNCERTIFIED_BIT)
        bucket_labels[bucket.mask] = labels[:n] | bits
        if bucket.repeats is not None:
            repeated, chosen = bucket.repeats
            bucket_labels[repeated] = bucket_labels[chosen]
    return bucket_labels, near_uncertified


def _label_elected(store: TileStore, cell: Cell, model: Model) -> UInt8:
    """Return the labels of the points that a pass elects in a bucket. Uncertified labels have bit 7."""
    labels, uncertified = model.label(
        Points(model.elect(_local(store.meta.bucket.bounds(cell), store)))
    )
    return labels | (uncertified.astype(np.uint8) * np.uint8(UNCERTIFIED_BIT))


def _elect(
    store: TileStore, cells: Sequence[Cell], model: Model, name: str | None
) -> tuple[str | None, list[int] | None]:
    """Write the points that a pass elects in buckets. Return the digest of the points, and their number per bucket.

    Digest and numbers are None if the pass elects no points.
    """
    if name is None:
        return None, None
    elected_by_cell = {}
    for cell in cells:
        elected_by_cell[cell] = model.elect(_local(store.meta.bucket.bounds(cell), store))
        store.write_elected(name, cell, elected_by_cell[cell])
    numbers = [int(xyz.shape[1]) for xyz in elected_by_cell.values()]
    return digest_of_arrays(*elected_by_cell.values()), numbers


def _window(store: TileStore, padded: Bounds, step: Pass, params: Any) -> tuple[Bounds, Window]:
    """Return the bounds of the points that a pass reads, and the same window in local counts with its open sides.

    ``padded`` is core and halo, which is the whole window of a pass with a fixed radius. For other passes the window is
    widened to the method's lattice.
    """
    if step.influence_radius_m is not None:
        return padded, _local(padded, store)
    align = Lattice(store.meta.frame.counts(Fraction(repr(float(params.align_m)))))
    margin = math.ceil(store.meta.frame.counts(Fraction(repr(float(params.margin_m)))))
    window = align.around(padded).pad(margin)
    return window, _known_window(store, window, margin=math.ceil(REACH_CELLS * align.size))


def _known_window(store: TileStore, window: Bounds, margin: int) -> Window:
    """Return the window in local counts. A side is open if there are no points within ``margin`` beyond it.

    Points farther away cannot change the result. The method surrounds the data with virtual
    points, which keep the circumcircles of the TIN within the margin.
    """
    padded = window.pad(margin)

    def empty(beyond: Bounds) -> bool:
        return not store.buckets_within(beyond)

    ox, oy = store.meta.frame.origin
    west = empty(Bounds(padded.x0, padded.y0, window.x0, padded.y1))
    east = empty(Bounds(window.x1, padded.y0, padded.x1, padded.y1))
    south = empty(Bounds(padded.x0, padded.y0, padded.x1, window.y0))
    north = empty(Bounds(padded.x0, window.y1, padded.x1, padded.y1))
    return Window(
        -OPEN if west else window.x0 - ox,
        -OPEN if south else window.y0 - oy,
        OPEN if east else window.x1 - ox,
        OPEN if north else window.y1 - oy,
    )


def _local(bounds: Bounds, store: TileStore) -> Window:
    return local_window(bounds, store.meta.frame.origin)


def local_window(bounds: Bounds, origin: tuple[int, int]) -> Window:
    """Convert bounds from absolute counts to local counts, which start at the origin."""
    ox, oy = origin
    return Window(bounds.x0 - ox, bounds.y0 - oy, bounds.x1 - ox, bounds.y1 - oy)
