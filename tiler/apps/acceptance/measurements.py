"""Measurements of clouds, and rows of the table: a row has a name, a unit, a kind of limit, and a function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from tiler.apps.acceptance.cells import CellFindings
from tiler.apps.acceptance.counts import FileCounts
from tiler.apps.acceptance.repeatability import Precision
from tiler.apps.acceptance.separation import Separation
from tiler.apps.acceptance.sheets import Coverage

Limit = Literal["at least", "at most", "only"]

MAX_PLACES = 5
"""Number of places and files that a row names."""


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
