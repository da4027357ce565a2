"""A method over tiles without a store: `tiler.filter` in memory, for comparison with the untiled run."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from ptd.cells import lowest_per_cell
from ptd.frame import OPEN, CellLattice, Scale, Window
from ptd.passes import Pass, Points, RunHints, later_passes

MARK = np.uint8(128)


def inside(points: Points, window: Window) -> np.ndarray:
    return window.contains(points.xyz[0], points.xyz[1])


def _given(points: Points, step: Any, labels: np.ndarray) -> Points:
    columns = {n: getattr(points, n) if n in step.columns else None for n in ("rgb", "returns")}
    return Points(points.xyz, labels if "labels" in step.columns else None, **columns)


def classify_tiled(
    points: Points,
    scale: Scale,
    params: Any,
    tile_m: float | None,
    halo_m: float = 0.0,
    sigma_m: float | None = None,
    kind: str | None = None,
) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Labels, marks and the last state. With ``tile_m`` None the cloud is one window with nothing beyond it.

    Windows are core and halo, widened to whole cells of `align_m`, and by `margin_m`; their
    sides are open at the end of the cloud. A pass with a fixed reach sees exactly that reach
    around a core. As in `tiler.filter`, a pass sees one candidate per `candidate_cell_m` unless
    it needs every point. A marked label in the window of a pass that reads labels marks the
    whole core. Elected points of a core are those within its bounds; a pass on such points
    labels them, unless it is the last.
    """
    n = len(points)
    labels, marks = np.zeros(n, np.uint8), np.zeros(n, bool)
    elected, codes, uncertified_codes = (
        Points(np.zeros((3, 0), np.int32)),
        np.zeros(0, np.uint8),
        np.zeros(0, bool),
    )
    state: dict[str, Any] = {"run": asdict(RunHints(sigma_m, kind))}
    for number, step in enumerate(params.passes):
        if not step.applies(state):
            continue
        last = step.gives_labels and not later_passes(params.passes, number, state)
        sees, labels_elected = _given(elected, step, codes), step.elected and not last
        given = sees if labels_elected else _given(points, step, labels)
        found, is_uncertified = np.zeros(len(given), np.uint8), np.zeros(len(given), bool)
        made = [Points(np.zeros((3, 0), np.int32), np.zeros(0, np.uint8))]
        partials = []
        for core, window in _windows(points, scale, params, step, tile_m, halo_m):
            own = np.flatnonzero(inside(given, core))
            if not inside(points, core).any():
                continue
            seen = np.flatnonzero(inside(sees if step.elected else points, window))
            if params.candidate_cell_m and not step.every_point and not step.elected:
                x, y, z = (np.ascontiguousarray(c) for c in points.xyz[:, seen])
                seen = seen[
                    lowest_per_cell(x, y, z, CellLattice.of(params.candidate_cell_m, scale))
                ]
            local = step.local(state, window, scale)
            model = step.fit(
                (sees if step.elected else given).take(seen), window, core, scale, local
            )
            partials.append(model.partial())
            if step.elects:
                made.append(Points(model.elect(core)))
                if step.gives_labels:
                    got, uncertified = model.label(made[-1])
                    near = "labels" in step.columns and bool(marks[seen].any())
                    made[-1] = Points(
                        made[-1].xyz, got | (uncertified | near).astype(np.uint8) * MARK
                    )
            elif step.gives_labels:
                reach = math.ceil(scale.counts(step.label_margin_m))
                wide = Window(
                    core.west - reach, core.south - reach, core.east + reach, core.north + reach
                )
                around = np.flatnonzero(inside(given, wide) & ~inside(given, core))
                got, uncertified = model.label(given.take(np.concatenate([own, around])))
                found[own], is_uncertified[own] = got[: own.size], uncertified[: own.size]
                before = uncertified_codes if step.elected else marks
                is_uncertified[own] |= "labels" in step.columns and bool(before[seen].any())
        if step.elects:
            elected = Points(np.concatenate([part.xyz for part in made], axis=1))
            codes, uncertified_codes = (
                np.zeros(len(elected), np.uint8),
                np.zeros(len(elected), bool),
            )
            if step.gives_labels:
                both = np.concatenate([part.known_labels() for part in made])
                codes, uncertified_codes = both & ~MARK, both >= MARK
        elif step.gives_labels and labels_elected:
            codes, uncertified_codes = found, is_uncertified
        elif step.gives_labels:
            labels, marks = found, is_uncertified
        state = step.reduce(partials, state)
    return labels, marks, state


def _windows(
    points: Points, scale: Scale, params: Any, step: Pass, tile_m: float | None, halo_m: float
) -> list[tuple[Window, Window]]:
    """Core and window of each tile."""
    everything = Window.everything()
    if tile_m is None:
        return [(everything, everything)]
    tiles, align = CellLattice.of(tile_m, scale), CellLattice.of(params.align_m, scale)
    halo, margin = math.ceil(scale.counts(halo_m)), math.ceil(scale.counts(params.margin_m))
    (x0, y0), (x1, y1) = points.xyz[:2].min(axis=1), points.xyz[:2].max(axis=1)
    found = []
    for row in range(tiles.row(int(y0)), tiles.row(int(y1)) + 1):
        for column in range(tiles.column(int(x0)), tiles.column(int(x1)) + 1):
            core = Window(
                tiles.west(column),
                tiles.south(row),
                tiles.west(column + 1),
                tiles.south(row + 1),
            )
            if step.influence_radius_m is not None:
                reach = math.ceil(scale.counts(step.influence_radius_m))
                sides = (
                    core.west - reach,
                    core.south - reach,
                    core.east + reach,
                    core.north + reach,
                )
                found.append((core, Window(*sides)))
                continue
            window = Window(
                align.west(align.column(core.west - halo)) - margin,
                align.south(align.row(core.south - halo)) - margin,
                align.west(align.column(core.east + halo - 1) + 1) + margin,
                align.south(align.row(core.north + halo - 1) + 1) + margin,
            )
            opened = replace(
                window,
                west=-OPEN if window.west < x0 else window.west,
                south=-OPEN if window.south < y0 else window.south,
                east=OPEN if window.east > x1 else window.east,
                north=OPEN if window.north > y1 else window.north,
            )
            found.append((core, opened))
    return found
