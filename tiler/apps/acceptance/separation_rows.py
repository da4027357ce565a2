"""The rows of the differences and of the repeatability of swaths."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from tiler.apps.acceptance.measurements import MAX_PLACES, Found, Measurements, Row
from tiler.apps.acceptance.repeatability import MIN_CELL_POINTS, MIN_CELLS
from tiler.apps.acceptance.separation import (
    FAULTS,
    MAX_NAMES,
    MIN_PAIR_CELLS,
    NO_OVERLAP,
    Separation,
    is_judged,
    pair_name,
)
from tiler.apps.results import SwathPair
from tiler.core.words import counted, listed

NO_CELLS = "no shared cell of swaths can be compared"


def _found(
    find: Callable[[Separation], Found],
) -> Callable[[Measurements], Found]:
    """Return a function that finds a value in the differences of swaths, if they were measured."""

    def found(measured: Measurements) -> Found:
        separation = measured.separation
        if isinstance(separation, str):
            return Found(None, remark=separation, has_nothing=separation == NO_OVERLAP)
        return find(separation)

    return found


def _worst(found: Separation, figure: Literal["rmse", "p95_abs"], more: str = "") -> Found:
    """Return the largest figure of a pair of swaths, with its name and more in the remark."""
    if not found.judged:
        return Found(None, remark=more or NO_CELLS)
    name, figures = max(found.judged, key=lambda pair: pair[1][figure] or 0.0)
    return Found(figures[figure], remark=f"{name}; {more}" if more else name)


def _coverage(found: Separation) -> str:
    """Return how much of the overlaps was compared, and why the rest was not."""
    shared = sum(pair["shared_cells"] for pair in found.pairs)
    cells = sum(pair["cells"] for pair in found.pairs)
    different = sum(pair["different_surfaces"] for pair in found.pairs)
    n_pairs = len(found.pairs) - len(found.uncompared)
    text = (
        f"even surfaces (ground and flat roofs) compared in {cells:,} of {shared:,} shared cells of "
        f"{found.side_m:.3g} m, {n_pairs:,} of {counted(len(found.pairs), 'pair')}"
    )
    if cells < shared:
        reasons = [f"{n:,} {fault}" for n, fault in zip(found.faults, FAULTS, strict=True) if n]
        text += f"; the other cells: {', '.join(reasons)}"
    if found.uncompared:
        text += f"; not compared: {listed(found.uncompared, MAX_NAMES, 'pairs')}"
    if different:
        text += f"; {counted(different, 'compared cell')} with different surfaces left out"
    return text


def _swath_difference_largest(found: Separation) -> Found:
    if not found.judged:
        return Found(None, remark=NO_CELLS)
    size_m = np.abs(found.difference_m)
    where = [
        f"{found.x[i]:.1f} {found.y[i]:.1f} ({_signed(found.difference_m[i])}, {found.second[i]} - {found.first[i]})"
        for i in np.lexsort((found.x, found.y, -size_m))[:MAX_PLACES].tolist()
    ]
    return Found(float(size_m.max()), where)


def _swath_step(found: Separation) -> Found:
    compared = [pair for pair in found.pairs if pair["cells"]]
    if not compared:
        return Found(None, remark=NO_CELLS)
    large = [pair for pair in compared if is_judged(pair)]
    small = [pair for pair in compared if not is_judged(pair)]
    remarks = [counted(len(large), "pair")] if large else []
    if small:
        remarks.append(
            f"{counted(len(small), 'pair')} with fewer than {MIN_PAIR_CELLS} cells not judged, the largest: "
            f"point source {_step(small[0])}"
        )
    where = [f"point source {_step(pair)}" for pair in large[:MAX_PLACES]]
    return Found(abs(large[0]["mean_m"] or 0.0) if large else None, where, "; ".join(remarks))


def _step(pair: SwathPair) -> str:
    return (
        f"{pair_name(pair)}: {_signed(pair['mean_m'] or 0.0)}, RMS {pair['rms_m']:.3f} m, "
        f"{counted(pair['cells'], 'cell')} around {pair['x']:.1f} {pair['y']:.1f}"
    )


def _repeatability(measured: Measurements) -> Found:
    if isinstance(measured.precision, str):
        return Found(None, remark=measured.precision)
    found, others = measured.precision
    if not found:
        return Found(
            None,
            remark=f"no swath has {MIN_CELLS} even cells with {MIN_CELL_POINTS} single returns",
        )
    where = [
        f"point source {swath.source}: {100 * swath.sigma_m:.2f} cm in {counted(swath.cells, 'cell')}, worst around "
        f"{swath.x:.1f} {swath.y:.1f} ({100 * swath.worst_m:.2f} cm)"
        for swath in found[:MAX_PLACES]
    ]
    if not others:
        return Found(found[0].sigma_m, where, counted(len(found), "swath"))
    remark = (
        f"{counted(len(others), 'swath')} without {MIN_CELLS} even cells with {MIN_CELL_POINTS} single returns: point "
        f"sources {listed([str(source) for source in others], MAX_NAMES)}"
    )
    return Found(None, where, remark)


def _signed(metres: float) -> str:
    """Return a length with its sign, and zero without a negative one."""
    return f"{round(metres, 3) + 0.0:+.3f} m"


SEPARATION_ROWS = (
    Row(
        "swath_difference",
        "m",
        "at most",
        _found(lambda s: _worst(s, "rmse", _coverage(s))),
        "root mean square of the height differences of the worst pair of swaths in cells of even surfaces (RMSDz)",
    ),
    Row(
        "swath_difference_p95",
        "m",
        "at most",
        _found(lambda s: _worst(s, "p95_abs")),
        "95th percentile of the absolute differences of the worst pair",
    ),
    Row(
        "swath_difference_largest",
        "m",
        "at most",
        _found(_swath_difference_largest),
        "largest absolute difference, also of cells with different surfaces",
    ),
    Row(
        "swath_step",
        "m",
        "at most",
        _found(_swath_step),
        "largest absolute mean difference of a pair of swaths, of those that share at least "
        f"{MIN_PAIR_CELLS} such cells",
    ),
    Row(
        "repeatability",
        "m",
        "at most",
        _repeatability,
        "standard deviation of the heights of a swath from the planes of even cells, for the worst swath (precision "
        "within a swath)",
    ),
)
