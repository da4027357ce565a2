"""The table of what is measured in clouds.

Names of rows are the keys of a specification, and stay.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from tiler.apps.acceptance.cells import CellFindings, Place, Swath
from tiler.apps.acceptance.counts import GPS_KINDS, FileCounts
from tiler.apps.acceptance.measurements import (
    MAX_PLACES,
    SEPARATION_ROWS,
    Found,
    Measurements,
    Row,
)
from tiler.core.words import counted

WITHOUT_SOURCES = "the points have no point source ids"
RANDOM_SOURCES = "the point source ids look random"


def _files(paths: Sequence[Path]) -> Found:
    return Found(len(paths), [str(path) for path in paths])


def _points(count: Callable[[FileCounts], int]) -> Callable[[Measurements], Found]:
    """Return a function that finds a number of points, and the files that have them."""
    return lambda measured: Found(
        measured.total(count), [str(path) for path in measured.paths(count)]
    )


def _values(value: Callable[[FileCounts], Any]) -> Callable[[Measurements], Found]:
    """Return a function that finds the different values of the files."""

    def find(measured: Measurements) -> Found:
        by_value = Counter(value(file) for file in measured.files if file.points)
        found = sorted(by_value)
        texts = [f"{v}: {counted(by_value[v], 'file')}" for v in found]
        return Found(found, remark=", ".join(texts) if len(texts) > 1 else "")

    return find


def _of_cells(
    find: Callable[[CellFindings, Measurements], Found],
) -> Callable[[Measurements], Found]:
    """Return a function that finds a value in the cells, if they were examined."""
    return lambda measured: (
        Found(None, remark=measured.cells)
        if isinstance(measured.cells, str)
        else find(measured.cells, measured)
    )


def _of_swaths(
    value: Callable[[Swath], float], join: Callable[[list[float]], float], names_least: bool
) -> Callable[[Measurements], Found]:
    """Return a function that finds the median or the least value of the swaths."""

    def find(cells: CellFindings, measured: Measurements) -> Found:
        if not _n_swaths(measured):
            return Found(None, remark=WITHOUT_SOURCES)
        if cells.n_random:
            return Found(None, remark=RANDOM_SOURCES)
        if not cells.swaths:
            return Found(None, remark="no swath is large enough")
        worst = sorted(cells.swaths, key=lambda swath: (value(swath), swath.source))
        where, remark = [], ""
        if names_least:
            where = [
                f"point source {swath.source}: {value(swath):.4g}"
                for swath in worst[:MAX_PLACES]
            ]
            small = f", {counted(cells.n_small, 'small one')} left out" if cells.n_small else ""
            remark = f"{counted(len(cells.swaths), 'swath')}{small}"
        return Found(join([value(swath) for swath in cells.swaths]), where, remark)

    return _of_cells(find)


def _number_of_places(
    places: Callable[[CellFindings], list[Place]],
) -> Callable[[Measurements], Found]:
    def find(cells: CellFindings, measured: Measurements) -> Found:
        found = places(cells)
        area = sum(place.area_m2 for place in found)
        where = [f"{p.x:.1f} {p.y:.1f} ({p.area_m2:,.0f} m2)" for p in found[:MAX_PLACES]]
        return Found(len(found), where, f"{area:,.0f} m2" if found else "")

    return _of_cells(find)


def _swath_gaps(cells: CellFindings, measured: Measurements) -> Found:
    if not _n_swaths(measured):
        return Found(None, remark=WITHOUT_SOURCES)
    if cells.n_random:
        return Found(None, remark=RANDOM_SOURCES)
    found = _number_of_places(lambda c: c.gaps)(measured)
    if cells.parts < 2:
        return found
    remark = (
        f"the survey falls into {cells.parts} separate parts; check each alone if this is right"
    )
    return Found(max(found.value, cells.parts - 1), found.where, remark)


def _overlap(cells: CellFindings, measured: Measurements) -> Found:
    if cells.n_random:
        return Found(None, remark=RANDOM_SOURCES)
    if cells.overlap_share is None or _n_swaths(measured) < 2:
        return Found(None, remark="the points have fewer than two swaths")
    return Found(100 * cells.overlap_share)


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


def _duplicates(measured: Measurements) -> Found:
    if len(measured.files) > 1 and measured.total(lambda file: file.outside):
        remark = (
            f"{counted(measured.n_duplicates, 'point')} at least; points lie outside the bounds of their file, so not "
            "all files were compared"
        )
        return Found(None, [str(p) for p in measured.with_duplicates], remark)
    timeless = measured.paths(lambda file: file.times_kind == "none")
    remark = "same x, y, z and GPS time"
    if timeless:
        remark = f"same x, y and z in {counted(len(timeless), 'file')} without GPS times"
    return Found(measured.n_duplicates, [str(p) for p in measured.with_duplicates], remark)


def _missing_sheets(measured: Measurements) -> Found:
    coverage = measured.coverage
    if isinstance(coverage, str):
        return Found(None, remark=coverage)
    remark = f"of {counted(coverage.number, 'sheet')} in {coverage.path}"
    if coverage.n_small:
        remark += f", {counted(coverage.n_small, 'sheet')} too small to know"
    return Found(len(coverage.missing), coverage.missing, remark)


def _flag(name: str, meaning: str) -> Row:
    find = _points(lambda file: file.flags[name])
    return Row(f"{name}_points", "points", "at most", find, meaning)


MISSING_SHEETS = Row(
    "missing_sheets",
    "sheets",
    "at most",
    _missing_sheets,
    "polygons of --sheets that first returns cover by less than half, with the share",
)
"""Row that is left out if neither sheets are given nor the specification asks for them."""

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
        lambda m: Found(max(f.scale_m for f in m.files)),
        "largest scale factor of x, y and z, each in metres by its unit",
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
        _of_cells(lambda c, m: Found(1 / math.sqrt(c.per_m2) if c.per_m2 else None)),
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
        "places inside the survey of at least 4 connected cells without a first return; water and dark surfaces are "
        "not told apart from missing data",
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
    *SEPARATION_ROWS,
    MISSING_SHEETS,
    Row(
        "duplicates",
        "points",
        "at most",
        _duplicates,
        "points with the x, y, z and GPS time of another point, in the same file or in another one",
    ),
)
NAMES = tuple(row.name for row in ROWS)
