"""The table of what is measured in clouds. A row has a name, a unit, a kind of limit, and a function.

Names of rows are the keys of a specification, and stay.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any, Literal

import numpy as np

from tiler.apps.acceptance.cells import CellFindings, Place, Swath
from tiler.apps.acceptance.counts import GPS_KINDS, FileCounts
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

Limit = Literal["at least", "at most", "only"]

MAX_PLACES = 5
"""Number of places and files that a row names."""
WITHOUT_SOURCES = "the points have no point source ids"
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
    metres : float
        Metres per unit of the CRS.
    cells : CellFindings or str
        Or the reason why cells were not examined.
    separation : Separation or str
        Differences of swaths, or the reason why they were not measured.
    n_duplicates : int
        Number of points that equal another one.
    with_duplicates : list of Path
        Files with such points.
    """

    files: list[FileCounts]
    without_crs: list[Path]
    crs_names: list[str]
    vertical_names: list[str]
    without_vertical: list[Path]
    metres: float
    cells: CellFindings | str
    separation: Separation | str
    n_duplicates: int
    with_duplicates: list[Path]

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


def _files(paths: Sequence[Path]) -> Found:
    return Found(len(paths), [str(path) for path in paths])


def _points(count: Callable[[FileCounts], int]) -> Callable[[Measurements], Found]:
    """Return a function that finds a number of points, and the files that have them."""

    def find(measured: Measurements) -> Found:
        return Found(measured.total(count), [str(path) for path in measured.paths(count)])

    return find


def _values(value: Callable[[FileCounts], Any]) -> Callable[[Measurements], Found]:
    """Return a function that finds the different values of the files."""

    def find(measured: Measurements) -> Found:
        by_value: dict[Any, int] = {}
        for file in measured.files:
            if file.points:
                by_value[value(file)] = by_value.get(value(file), 0) + 1
        found = sorted(by_value)
        remark = ""
        if len(found) > 1:
            remark = ", ".join(f"{v}: {counted(by_value[v], 'file')}" for v in found)
        return Found(found, remark=remark)

    return find


def _of_cells(
    find: Callable[[CellFindings, Measurements], Found],
) -> Callable[[Measurements], Found]:
    """Return a function that finds a value in the cells, if they were examined."""

    def found(measured: Measurements) -> Found:
        if isinstance(measured.cells, str):
            return Found(None, remark=measured.cells)
        return find(measured.cells, measured)

    return found


def _of_swaths(
    value: Callable[[Swath], float], join: Callable[[list[float]], float], names_least: bool
) -> Callable[[Measurements], Found]:
    """Return a function that finds the median or the least value of the swaths."""

    def find(cells: CellFindings, measured: Measurements) -> Found:
        if not cells.swaths:
            return Found(None, remark="no swath is large enough")
        worst = sorted(cells.swaths, key=lambda swath: (value(swath), swath.source))
        where, remark = [], ""
        if names_least:
            where = [
                f"point source {swath.source}: {value(swath):.4g}"
                for swath in worst[:MAX_PLACES]
            ]
            remark = counted(len(cells.swaths), "swath")
            remark += (
                f", {counted(cells.n_small, 'small one')} left out" if cells.n_small else ""
            )
        return Found(join([value(swath) for swath in cells.swaths]), where, remark)

    return _of_cells(find)


def _places(places: Sequence[Place]) -> list[str]:
    return [f"{p.x:.1f} {p.y:.1f} ({p.area_m2:,.0f} m2)" for p in places[:MAX_PLACES]]


def _number_of_places(
    places: Callable[[CellFindings], list[Place]],
) -> Callable[[Measurements], Found]:
    def find(cells: CellFindings, measured: Measurements) -> Found:
        found = places(cells)
        area = sum(place.area_m2 for place in found)
        return Found(len(found), _places(found), f"{area:,.0f} m2" if found else "")

    return _of_cells(find)


def _swath_gaps(cells: CellFindings, measured: Measurements) -> Found:
    if not _n_swaths(measured):
        return Found(None, remark=WITHOUT_SOURCES)
    found = _number_of_places(lambda c: c.gaps)(measured)
    if cells.parts < 2:
        return found
    remark = (
        f"the survey falls into {cells.parts} separate parts; check each alone if this is right"
    )
    return Found(max(found.value, cells.parts - 1), found.where, remark)


def _overlap(cells: CellFindings, measured: Measurements) -> Found:
    if cells.overlap_share is None or _n_swaths(measured) < 2:
        return Found(None, remark="the points have fewer than two swaths")
    return Found(100 * cells.overlap_share)


def _of_separation(
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


def _signed(metres: float) -> str:
    """Return a length with its sign, and zero without a negative one."""
    return f"{round(metres, 3) + 0.0:+.3f} m"


def _dense_cells(cells: CellFindings, measured: Measurements) -> Found:
    if cells.dense_share is None:
        return Found(None, remark="pulse_density is not asked, or no square is inside")
    return Found(100 * cells.dense_share)


def _n_swaths(measured: Measurements) -> int:
    return len({source for file in measured.files for source in file.sources if source})


def _classes(measured: Measurements) -> Found:
    counts = np.sum([file.classes for file in measured.files], axis=0)
    found = np.flatnonzero(counts).tolist()
    return Found(found, remark=", ".join(f"{code}: {counts[code]:,}" for code in found))


def _spacing(cells: CellFindings, measured: Measurements) -> Found:
    return Found(1 / math.sqrt(cells.per_m2) if cells.per_m2 else None)


def _duplicates(measured: Measurements) -> Found:
    if len(measured.files) > 1 and measured.total(lambda file: file.outside):
        return Found(
            None,
            remark="points lie outside the bounds of their file, so not all files were compared",
        )
    timeless = measured.paths(lambda file: file.times_kind == "none")
    remark = "same x, y, z and GPS time"
    if timeless:
        remark = f"same x, y and z in {counted(len(timeless), 'file')} without GPS times"
    return Found(measured.n_duplicates, [str(p) for p in measured.with_duplicates], remark)


def _flag(name: str, meaning: str) -> Row:
    find = _points(lambda file: file.flags[name])
    return Row(f"{name}_points", "points", "at most", find, meaning)


ROWS = (
    Row("las_version", "", "only", _values(lambda f: f.version), "versions of LAS"),
    Row("point_format", "", "only", _values(lambda f: f.point_format), "point formats"),
    Row(
        "files_without_crs",
        "files",
        "at most",
        lambda m: _files(m.without_crs),
        "files without a horizontal CRS; their coordinates are taken as metres",
    ),
    Row(
        "different_crs",
        "CRSs",
        "at most",
        lambda m: Found(len(m.crs_names), remark="; ".join(m.crs_names)),
        "different horizontal CRSs of the files",
    ),
    Row(
        "different_vertical_crs",
        "CRSs",
        "at most",
        lambda m: Found(len(m.vertical_names), remark="; ".join(m.vertical_names)),
        "different vertical CRSs of the files",
    ),
    Row(
        "files_without_vertical_crs",
        "files",
        "at most",
        lambda m: _files(m.without_vertical),
        "files without a vertical CRS",
    ),
    Row(
        "files_without_wkt",
        "files",
        "at most",
        lambda m: _files(m.paths(lambda f: not f.wkt_bit)),
        "files whose header does not say that the CRS is WKT",
    ),
    Row(
        "gps_time",
        "",
        "only",
        _values(lambda f: f.times_kind),
        f"GPS times by the header: {', '.join(f'`{kind}`' for kind in GPS_KINDS)}; files without points do not count",
    ),
    Row(
        "points_outside_bounds",
        "points",
        "at most",
        _points(lambda f: f.outside),
        "points outside the bounds in the header of their file",
    ),
    Row(
        "files_with_wrong_returns",
        "files",
        "at most",
        lambda m: _files(m.paths(lambda f: not f.has_stated_returns)),
        "files whose header has other numbers of points by return than were counted",
    ),
    Row(
        "coordinate_step",
        "m",
        "at most",
        lambda m: Found(max(f.scale for f in m.files) * m.metres),
        "largest scale factor of coordinates",
    ),
    Row("classes", "", "only", _classes, "classes of the points"),
    _flag("withheld", "points with the withheld flag"),
    _flag("overlap", "points with the overlap flag, or of class 12 in point formats 0 to 5"),
    _flag("synthetic", "points with the synthetic flag"),
    _flag("key", "points with the flag for model key points"),
    Row(
        "wrong_return_numbers",
        "points",
        "at most",
        _points(lambda f: f.wrong_returns),
        "points whose return number is 0 or above the number of returns of their pulse",
    ),
    Row(
        "points_without_source",
        "points",
        "at most",
        _points(lambda f: f.sources.get(0, 0)),
        "points with point source id 0",
    ),
    Row(
        "swaths",
        "swaths",
        "at least",
        lambda m: Found(_n_swaths(m)),
        "different point source ids that are not 0",
    ),
    Row(
        "files_without_intensity",
        "files",
        "at most",
        lambda m: _files(m.paths(lambda f: f.points and not f.with_intensity)),
        "files in which all intensities are 0",
    ),
    Row(
        "pulse_density",
        "per m2",
        "at least",
        _of_cells(lambda c, m: Found(c.per_m2)),
        "first returns of all swaths per square metre of the survey without its wide data voids",
    ),
    Row(
        "pulse_spacing",
        "m",
        "at most",
        _of_cells(_spacing),
        "nominal pulse spacing of all swaths, 1 / sqrt(pulse_density); its limit also gives the side of the cells",
    ),
    Row(
        "swath_density_median",
        "per m2",
        "at least",
        _of_swaths(lambda s: s.per_m2, median, names_least=False),
        "median over the swaths of the first returns of a swath per square metre of its own area",
    ),
    Row(
        "swath_density_least",
        "per m2",
        "at least",
        _of_swaths(lambda s: s.per_m2, min, names_least=True),
        "least density of a swath",
    ),
    Row(
        "dense_cells",
        "%",
        "at least",
        _of_cells(_dense_cells),
        "share of squares of 5 x 5 cells inside the survey that reach pulse_density",
    ),
    Row(
        "distribution",
        "%",
        "at least",
        _of_swaths(lambda s: 100 * s.share, min, names_least=True),
        "share of the cells of a swath that contain a first return, for the worst swath; wide data voids do not count",
    ),
    Row(
        "distribution_median",
        "%",
        "at least",
        _of_swaths(lambda s: 100 * s.share, median, names_least=False),
        "median of this share over the swaths",
    ),
    Row(
        "voids",
        "places",
        "at most",
        _number_of_places(lambda c: c.voids),
        "places inside the survey of at least 2 x 2 cells without a first return; water and dark surfaces are not told "
        "apart from missing data",
    ),
    Row(
        "void_area",
        "m2",
        "at most",
        _of_cells(lambda c, m: Found(sum(v.area_m2 for v in c.voids))),
        "area of all data voids",
    ),
    Row(
        "swath_overlap",
        "%",
        "at least",
        _of_cells(_overlap),
        "share of the covered area that two swaths or more cover",
    ),
    Row(
        "swath_gaps",
        "places",
        "at most",
        _of_cells(_swath_gaps),
        "places between the convex outlines of two swaths, 3 to 128 cells wide, without a first return, and "
        "separations of the survey into parts",
    ),
    Row(
        "swath_difference",
        "m",
        "at most",
        _of_separation(lambda s: _worst(s, "rmse", _coverage(s))),
        "root mean square of the height differences of the worst pair of swaths in cells of even surfaces (RMSDz)",
    ),
    Row(
        "swath_difference_p95",
        "m",
        "at most",
        _of_separation(lambda s: _worst(s, "p95_abs")),
        "95th percentile of the absolute differences of the worst pair",
    ),
    Row(
        "swath_difference_largest",
        "m",
        "at most",
        _of_separation(_swath_difference_largest),
        "largest absolute difference, also of cells with different surfaces",
    ),
    Row(
        "swath_step",
        "m",
        "at most",
        _of_separation(_swath_step),
        "largest absolute mean difference of a pair of swaths, of those that share at least "
        f"{MIN_PAIR_CELLS} such cells",
    ),
    Row(
        "duplicates",
        "points",
        "at most",
        _duplicates,
        "points with the x, y, z and GPS time of another point, in the same file or in another one",
    ),
)
NAMES = tuple(row.name for row in ROWS)
