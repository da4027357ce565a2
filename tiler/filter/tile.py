"""A tile of a pass: read core and halo, fit the model, label the core; the last pass writes the labels."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from ptd.frame import OPEN, Scale
from ptd.frame import Window as Known
from ptd.methods import METHODS
from ptd.passes import Model
from tiler.core.classes import participates
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.points import PointBlock
from tiler.store import TileStore, open_store

LABELS = "labels"
"""Name of the final labels in the store."""

MARK_BIT = 0x80
KEEP = 0
"""Label of a point that has no part in filtering: it keeps the class of its source."""

REACH_CELLS = 4
"""So many cells of a method's lattice beyond a window, an occupied bucket still tells that the data go on there."""


def sight_m(params: Any) -> float:
    """Metres beyond core and halo from which buckets can change a tile, for the parameters of a method."""
    return float((REACH_CELLS + 1) * params.align_m + params.margin_m)


def filter_tile(store_url: str, args: dict[str, Any]) -> dict[str, Any]:
    """Filter one tile.

    A core that carries a mark is done again with twice the halo, up to ``max_halo``; what stays marked
    keeps its mark (bit 7 of the label) and is counted.

    Parameters
    ----------
    store_url : str
    args : dict
        ``method``, ``parameters`` (JSON of the dataclass), ``pass`` (number), ``state`` (of the passes before);
        ``cells`` ([[ix, iy], ...], the buckets of the core); ``halo``, ``max_halo`` (counts); ``keep_classes``,
        ``skip_flags``: see `tiler.core.classes.participates`.

    Returns
    -------
    dict
        ``cells``; ``points``, ``ground``, ``low_noise``, ``unclassified``, ``kept`` (of the core), ``marked``,
        ``tries``, ``halo`` (counts), ``window_points`` (candidates of the last window), ``core_area``,
        ``window_area`` (square counts, all tries), ``labels`` (digest), ``partial`` (for the pass's reduction),
        ``stats`` of the model.
    """
    store = open_store(store_url)
    params = METHODS[args["method"]].params(**args["parameters"])
    step = params.passes[args["pass"]]
    scale = Scale(store.meta.frame.metres_xy, store.meta.frame.metres_z, store.meta.frame.origin)
    cells = [Cell(int(ix), int(iy)) for ix, iy in args["cells"]]
    core = _hull(store.meta.bucket, cells)
    align = Lattice(store.meta.frame.counts(Fraction(repr(float(params.align_m)))))
    margin = math.ceil(store.meta.frame.counts(Fraction(repr(float(params.margin_m)))))
    halo, tries, area = int(args["halo"]), 0, 0
    while True:
        tries += 1
        window = _aligned(core.pad(halo), align).pad(margin)
        area += window.area()
        known = _known(store, window, reach=math.ceil(REACH_CELLS * align.size))
        candidates = _candidates(store, window, params.candidate_cell_m, args)
        model = step.fit(candidates, known, scale, args["state"])
        labels = {cell: _label(store, cell, model, args) for cell in cells}
        marked = sum(int(np.count_nonzero(found & MARK_BIT)) for found in labels.values())
        if marked == 0 or halo >= args["max_halo"]:
            break
        halo = min(2 * halo, int(args["max_halo"]))
    if args["pass"] == len(params.passes) - 1:
        for cell, found in labels.items():
            store.write_labels(LABELS, cell, found)
    counts = np.bincount(np.concatenate(list(labels.values())) & ~np.uint8(MARK_BIT), minlength=256)
    return {
        "points": int(counts.sum()), "ground": int(counts[2]), "low_noise": int(counts[7]),
        "unclassified": int(counts[1]), "kept": int(counts[KEEP]), "marked": marked, "tries": tries, "halo": halo,
        "window_points": int(candidates.shape[1]), "core_area": core.area(), "window_area": area,
        "cells": args["cells"], "labels": _digest(labels.values()), "partial": model.partial(), "stats": model.stats,
    }  # fmt: skip


def _hull(lattice: Lattice, cells: Iterable[Cell]) -> Bounds:
    bounds = [lattice.bounds(cell) for cell in cells]
    hull = bounds[0]
    for other in bounds[1:]:
        hull = hull.union(other)
    return hull


def _aligned(bounds: Bounds, lattice: Lattice) -> Bounds:
    """Widened to whole cells of a lattice."""
    first, index = lattice.first, lattice.index_of
    return Bounds(
        first(index(bounds.x0)),
        first(index(bounds.y0)),
        first(index(bounds.x1 - 1) + 1),
        first(index(bounds.y1 - 1) + 1),
    )


def _known(store: TileStore, window: Bounds, reach: int) -> Known:
    """The window in local counts; a side is open where no bucket within ``reach`` of it holds a point beyond it.

    The virtual ring of a method keeps every circle that matters within that reach of the data.
    """
    wide, occupied, lattice = window.pad(reach), store.buckets(), store.meta.bucket

    def empty(strip: Bounds) -> bool:
        return not any(cell in occupied for cell in lattice.cells(strip))

    ox, oy = store.meta.frame.origin
    west = empty(Bounds(wide.x0, wide.y0, window.x0, wide.y1))
    east = empty(Bounds(window.x1, wide.y0, wide.x1, wide.y1))
    south = empty(Bounds(wide.x0, wide.y0, wide.x1, window.y0))
    north = empty(Bounds(wide.x0, window.y1, wide.x1, wide.y1))
    return Known(
        -OPEN if west else window.x0 - ox, -OPEN if south else window.y0 - oy,
        OPEN if east else window.x1 - ox, OPEN if north else window.y1 - oy,
    )  # fmt: skip


def _candidates(
    store: TileStore, window: Bounds, cell_m: float, args: dict[str, Any]
) -> npt.NDArray[np.int32]:
    """Points that can become vertices: the store's candidates where the method's cells are made of whole fine cells."""
    fine = store.meta.fine.size
    nested = cell_m > 0 and (store.meta.frame.counts(Fraction(repr(float(cell_m)))) / fine).denominator == 1
    if nested:
        return store.window(window, ("xyz",), candidates_only=True).xyz
    block = store.window(window, ("xyz", "classification", "flags"), candidates_only=False)
    return block.xyz[:, _taking_part(block, args)]


def _label(store: TileStore, cell: Cell, model: Model, args: dict[str, Any]) -> npt.NDArray[np.uint8]:
    """Labels with marks of all points of a bucket, in its order."""
    block = store.read_bucket(cell, ("xyz", "classification", "flags"))
    labels, marked = model.label(block.xyz)
    labels = labels | (marked.astype(np.uint8) * np.uint8(MARK_BIT))
    labels[~_taking_part(block, args)] = KEEP
    return labels


def _taking_part(block: PointBlock, args: dict[str, Any]) -> npt.NDArray[np.bool_]:
    if block.classification is None or block.flags is None:
        raise ValueError("points were read without their classes and flags")
    return participates(block.classification, block.flags, args["keep_classes"], args["skip_flags"])


def _digest(columns: Iterable[npt.NDArray[np.uint8]]) -> str:
    digest = hashlib.blake2b(digest_size=16)
    for column in columns:
        digest.update(column.tobytes())
    return digest.hexdigest()
