"""A tile of a pass: read core and halo, fit the model, label the core; the last pass writes the labels."""

from __future__ import annotations

import dataclasses
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
from ptd.passes import Model, Pass, Points
from tiler.core.classes import GROUND, LOW_NOISE, MARK_BIT, UNCLASSIFIED, participates
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.points import PointBlock
from tiler.store import TileStore, open_store

LABELS = "labels"
"""Name of the final labels in the store."""

KEEP = 0
"""Label of a point that has no part in filtering: it keeps the class of its source."""

REACH_CELLS = 4
"""Cells of a method's lattice beyond a window within which an occupied bucket shows that the data go on there."""


def sight_m(step: Pass, params: Any) -> float:
    """Metres beyond core and halo from which buckets can change a tile, for a pass and its method's parameters."""
    return float((REACH_CELLS + 1) * params.align_m + params.margin_m) if step.reach_m is None else 0.0


def filter_tile(store_url: str, args: dict[str, Any]) -> dict[str, Any]:
    """Filter one tile.

    A core that carries a mark, or of whose statistics the pass is not certain, is done again with twice the halo, up
    to ``max_halo``; what stays marked keeps its mark (bit 7 of the label) and is counted. The window of a pass with a
    fixed reach is core and halo as they are; that of any other is widened to the method's lattice, and knows where the
    data end.

    Parameters
    ----------
    store_url : str
    args : dict
        ``method``, ``parameters`` (JSON of the dataclass), ``pass`` (number), ``state`` (of the passes before);
        ``cells`` ([[ix, iy], ...], the buckets of the core); ``halo``, ``max_halo`` (counts); ``keep_classes``,
        ``skip_flags``: see `tiler.core.classes.participates`; ``labels_in``, ``labels_out``: names in the store of
        the labels of the pass before and of this one, or None.

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
    core = store.meta.bucket.hull(cells)
    halo, tries, area = int(args["halo"]), 0, 0
    inner = _local(core, store)
    while True:
        tries += 1
        window, known = _window(store, core.pad(halo), step, params)
        area += window.area()
        points, inherited = _points(store, window, step, params.candidate_cell_m, args)
        model = step.fit(points, known, inner, scale, args["state"])
        labels = {cell: _label(store, cell, step, model, args) for cell in cells} if step.gives_labels else {}
        marked = sum(int(np.count_nonzero(found & MARK_BIT)) for found in labels.values())
        if (marked == 0 and model.uncertain() == 0) or halo >= args["max_halo"]:
            break
        halo = min(2 * halo, int(args["max_halo"]))
    if inherited:  # what a doubtful label of the pass before may have changed
        labels = {cell: found | (found > 0) * np.uint8(MARK_BIT) for cell, found in labels.items()}
        marked = sum(int(np.count_nonzero(found)) for found in labels.values())
    for cell, found in labels.items():
        store.write_labels(args["labels_out"], cell, found)
    joined = np.concatenate(list(labels.values())) if labels else np.zeros(0, np.uint8)
    counts = np.bincount(joined & ~np.uint8(MARK_BIT), minlength=256)
    return {
        "points": int(counts.sum()), "ground": int(counts[GROUND]), "low_noise": int(counts[LOW_NOISE]),
        "unclassified": int(counts[UNCLASSIFIED]), "kept": int(counts[KEEP]),
        "marked": marked, "tries": tries, "halo": halo,
        "window_points": len(points), "core_area": core.area(), "window_area": area,
        "cells": args["cells"], "labels": _digest(labels.values()), "partial": model.partial(), "stats": model.stats,
    }  # fmt: skip


def _window(store: TileStore, padded: Bounds, step: Pass, params: Any) -> tuple[Bounds, Known]:
    """What a pass reads for a core and its halo, and what it is told of it."""
    if step.reach_m is not None:
        return padded, _local(padded, store)
    align = Lattice(store.meta.frame.counts(Fraction(repr(float(params.align_m)))))
    margin = math.ceil(store.meta.frame.counts(Fraction(repr(float(params.margin_m)))))
    window = align.around(padded).pad(margin)
    return window, _known(store, window, reach=math.ceil(REACH_CELLS * align.size))


def _known(store: TileStore, window: Bounds, reach: int) -> Known:
    """The window in local counts; a side is open where no bucket within ``reach`` of it holds a point beyond it.

    The virtual ring of a method keeps every circle that matters within that reach of the data.
    """
    wide = window.pad(reach)

    def empty(strip: Bounds) -> bool:
        return not store.buckets_within(strip)

    ox, oy = store.meta.frame.origin
    west = empty(Bounds(wide.x0, wide.y0, window.x0, wide.y1))
    east = empty(Bounds(window.x1, wide.y0, wide.x1, wide.y1))
    south = empty(Bounds(wide.x0, wide.y0, wide.x1, window.y0))
    north = empty(Bounds(wide.x0, window.y1, wide.x1, wide.y1))
    return Known(
        -OPEN if west else window.x0 - ox, -OPEN if south else window.y0 - oy,
        OPEN if east else window.x1 - ox, OPEN if north else window.y1 - oy,
    )  # fmt: skip


def _local(bounds: Bounds, store: TileStore) -> Known:
    ox, oy = store.meta.frame.origin
    return Known(bounds.x0 - ox, bounds.y0 - oy, bounds.x1 - ox, bounds.y1 - oy)


def _points(
    store: TileStore, window: Bounds, step: Pass, cell_m: float, args: dict[str, Any]
) -> tuple[Points, bool]:
    """What a pass looks at, and whether a label among it is marked.

    Points that can become vertices: the store's candidates where the method's cells are made of whole fine cells.
    """
    fine = store.meta.fine.size
    nested = cell_m > 0 and (store.meta.frame.counts(Fraction(repr(float(cell_m)))) / fine).denominator == 1
    few = nested and not step.every_point
    labels = args["labels_in"] if "labels" in step.columns else None
    columns = _stored_columns(step)
    if few:
        block = store.window(window, columns, candidates_only=True, labels=labels)
    else:
        block = store.window(window, (*columns, "classification", "flags"), labels=labels)
        block = block.take(_taking_part(block, args))
    inherited = block.labels is not None and bool((block.labels >= MARK_BIT).any())
    return _as_points(block), inherited


def _stored_columns(step: Pass) -> tuple[str, ...]:
    return ("xyz", *(name for name in step.columns if name != "labels"))


def _as_points(block: PointBlock) -> Points:
    labels = None if block.labels is None else block.labels & ~np.uint8(MARK_BIT)
    return Points(block.xyz, labels, block.rgb, block.returns)


def _label(
    store: TileStore, cell: Cell, step: Pass, model: Model, args: dict[str, Any]
) -> npt.NDArray[np.uint8]:
    """Labels with marks of all points of a bucket, in its order."""
    block = store.read_bucket(cell, (*_stored_columns(step), "classification", "flags"))
    if "labels" in step.columns and args["labels_in"] is not None:
        block = dataclasses.replace(block, labels=store.read_labels(args["labels_in"], cell))
    labels, marked = model.label(_as_points(block))
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
