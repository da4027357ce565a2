"""Measurements of clouds, and rows of the table: a row has a name, a unit, a kind of limit, and a function.

The rows of the differences and of the repeatability of swaths are here, the others in `rows`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tiler.apps.acceptance.cells import CellFindings
from tiler.apps.acceptance.counts import FileCounts
from tiler.apps.acceptance.separation import (
    FAULTS,
    MAX_NAMES,
    MIN_CELL_POINTS,
    MIN_CELLS,
    MIN_PAIR_CELLS,
    NO_OVERLAP,
    Precision,
    Separation,
    is_judged,
    pair_name,
)
from tiler.apps.acceptance.sheets import Coverage
from tiler.apps.results import SwathPair
from tiler.core.words import counted, listed

Limit = Literal["at least", "at most", "only"]

MAX_PLACES = 1000
"""Number of places that a row names. Texts and pages show the first of them."""
LARGEST = 5
"""Number of cells that the row of the largest difference names."""


NO_CELLS = "no shared cell of swaths can be compared"


@dataclass(frozen=True)
class Measurements:
    """What was measured in all files.

    Attributes
    ----------
    files : list of FileCounts
        In the order of the paths.
    without_crs, without_vertical : list of Path
        Files without a horizontal or a vertical CRS.
    crs_names, vertical_names : list of str
        Names of the different horizontal and vertical CRSs.
    cells : CellFindings or str
        Or the reason why cells were not examined.
    separation : Separation or str
        Differences of swaths, or the reason why they were not measured.
    precision : (list of Precision, list of int) or str
        Repeatability of swaths, the worst first, or the reason.
    n_duplicates : int
        Number of points that equal another one.
    with_duplicates : list of Path
        Files with such points.
    coverage : Coverage or str
        Sheets that are not covered, or why they are not known.
    strays : str
        Note about first returns far from all others, which are left out of ``cells``.
    """

    files: list[FileCounts]
    without_crs: list[Path]
    crs_names: list[str]
    vertical_names: list[str]
    without_vertical: list[Path]
    cells: CellFindings | str
    separation: Separation | str
    precision: tuple[list[Precision], list[int]] | str
    n_duplicates: int
    with_duplicates: list[Path]
    coverage: Coverage | str
    strays: str

    def total(self, count: Callable[[FileCounts], int]) -> int:
        """Return the sum of a count over all files."""
        return sum(count(file) for file in self.files)

    def paths(self, is_one: Callable[[FileCounts], object]) -> list[Path]:
        """Return the files for which a function is true."""
        return [file.path for file in self.files if is_one(file)]


@dataclass(frozen=True)
class Found:
    """Value of a row, and where it comes from.

    Attributes
    ----------
    value : number, list or None
        None: not measured.
    where : list of str
        Files, or places in the CRS.
    remark : str
        More about the value, or the reason why it was not measured.
    has_nothing : bool
        Whether there is nothing to measure, so that every limit is met.
    """

    value: Any
    where: list[str] = field(default_factory=list)
    remark: str = ""
    has_nothing: bool = False


@dataclass(frozen=True)
class Row:
    """Row of the table.

    Attributes
    ----------
    name : str
    unit : str
        ``m``, ``m2``, ``per m2``, ``%``, ``points``, ``files``, another noun, or empty for lists.
    limit : str
        Whether the asked value is a minimum (``at least``), a maximum (``at most``) or a list of allowed values.
    find : callable
    meaning : str
        Sentence without a full stop for the documentation.
    """

    name: str
    unit: str
    limit: Limit
    find: Callable[[Measurements], Found]
    meaning: str


def _found(
    find: Callable[[Separation], Found],
) -> Callable[[Measurements], Found]:
    """Return a function that finds a value in the differences of swaths, if they were measured."""
    return lambda m: (
        Found(None, remark=m.separation, has_nothing=m.separation == NO_OVERLAP)
        if isinstance(m.separation, str)
        else find(m.separation)
    )


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
        for i in np.lexsort((found.x, found.y, -size_m))[:LARGEST].tolist()
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
