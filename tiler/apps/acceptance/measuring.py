"""Check of clouds: inspect files, count their points in child processes, and compare the rows with what is asked."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from pyproj import CRS

from tiler.apps.acceptance.cells import (
    MOST_LEFT_OUT,
    SPACINGS_PER_CELL,
    CellFindings,
    examine_cells,
    needed_bytes,
)
from tiler.apps.acceptance.counts import (
    MAX_HEIGHT_M,
    N_SUMS,
    Cells,
    DigestPlan,
    FileCounts,
    Survey,
    count_file,
    merged,
    survey_of,
)
from tiler.apps.acceptance.duplicates import (
    DigestFiles,
    number_of_parts,
    read_digests,
    repeated,
    scratch_folder,
)
from tiler.apps.acceptance.measurements import Found, Measurements, Row
from tiler.apps.acceptance.page import MAKER, acceptance_page
from tiler.apps.acceptance.rows import (
    MISSING_SHEETS,
    RANDOM_SOURCES,
    ROWS,
    WITHOUT_SOURCES,
)
from tiler.apps.acceptance.separation import (
    MAX_NAMES,
    NO_OVERLAP,
    Precision,
    Separation,
    find_surfaces,
    repeatability,
    separate_swaths,
    share_cells,
    too_large,
)
from tiler.apps.acceptance.sheets import (
    Coverage,
    Sheets,
    covered_sheets,
    read_sheets,
    validate_not_grid,
)
from tiler.apps.acceptance.specification import Specification
from tiler.apps.results import AcceptanceRow, AcceptanceSummary
from tiler.core.crs import crs_name, same_horizontal, split_wkt
from tiler.core.units import METRE
from tiler.core.words import counted, listed
from tiler.errors import ConfigError, InputError
from tiler.inputs import (
    SourceInfo,
    find_inputs,
    inspect_in_child,
    read_in_child,
    validate_lengths,
)
from tiler.io.las.headers import AGAIN, SALVAGE
from tiler.io.overwrite_check import check_difference
from tiler.observe.progress import size_text
from tiler.report.document import validate_page
from tiler.report.runfile import write_whole
from tiler.schedule import ChildPool, ChildProcess, half_of_memory
from tiler.schedule.guard import ChildMemoryError

MAX_CHILDREN = 8
"""Maximum number of processes that read files at the same time."""
LEAST_MEMORY = 256 << 20
"""Least memory limit in bytes. With half of it, a process may hang instead of failing."""
SIDE_TOLERANCE = 1.25
"""Ratio of the sides of cells, by the headers and by the measured density, above which the points are counted again."""
MAX_COUNTS = 6
"""Number of times that points are counted, with better sides of cells. More than two are for bounds with strays."""
BOUNDS_MARGIN = 1.0
"""Width in units of the CRS by which the bounds of a file are widened, since headers may be rounded."""

USUAL_LIMIT_M = 0.08
"""Limit of the colours of differences if the specification has none: that of quality levels 1 and 2 of USGS."""

DIFFERENT_CRS = "the files have different CRSs"
DIFFERENT_VERTICAL_CRS = "the files have different vertical CRSs"
FAR_APART = "the clouds lie farther apart than cells reach"


def check_clouds(
    inputs: Sequence[str | Path],
    specification: Specification | None = None,
    difference: Path | None = None,
    page: Path | None = None,
    sheets: str | Path | None = None,
    sheet_field: str | None = None,
    workers: int | None = None,
    memory: int | None = None,
) -> AcceptanceSummary:
    """Measure all rows of clouds, and compare them with a specification.

    Parameters
    ----------
    inputs : sequence of path
        Files, folders, globs and virtual point clouds.
    specification : Specification, optional
        What is asked. Without it, nothing is asked.
    difference : Path, optional
        GeoTIFF that receives the differences of swaths.
    page : Path, optional
        HTML file that receives the page.
    sheets : path, optional
        Polygons of the sheets that must be covered.
    sheet_field : str, optional
        Field of the polygons with the names of the sheets.
    workers : int, optional
        Number of processes that read files. By default it is the number of cores, at most `MAX_CHILDREN`.
    memory : int, optional
        Memory limit of each process in bytes. By default this process may use half of the machine's memory, and so may
        the others together.

    Raises
    ------
    ConfigError
        A path does not exist. Or ``difference`` is an input, or not the name of a GeoTIFF in a folder. Or ``page`` is
        an input, a file that is not an earlier page, or not the name of an HTML file in a folder. Or ``sheets`` is a
        length. Or ``memory`` is below `LEAST_MEMORY`.
    InputError
        A file cannot be read, its CRS has angles, no file has points, or the sheets do not have the field.
    ProcessingError
        The GeoTIFF or the page cannot be written.
    """
    if memory is not None and memory < LEAST_MEMORY:
        raise ConfigError(
            f"memory {memory}: a process that checks clouds needs {size_text(LEAST_MEMORY)} or more; give more"
        )
    notes: list[str] = []
    paths = find_inputs(inputs, note=notes.append, results=True)
    if sheets is not None:
        validate_not_grid(str(sheets))
    if difference is not None:
        check_difference(difference, paths)
    if page is not None:
        validate_page(page, [*paths, *([sheets] if sheets else [])], MAKER)
    n_children = min(len(paths), workers or min(psutil.cpu_count() or 1, MAX_CHILDREN))
    child_memory = memory or half_of_memory() // n_children
    memory = memory or half_of_memory()
    with (
        _remedies_of_check(),
        scratch_folder() as folder,
        ChildPool(n_children, child_memory) as children,
    ):
        infos = [look() for look in children.each(inspect_in_child, paths)]
        if not any(info.points for info in infos):
            raise InputError(
                f"{paths[0]}: no points in {counted(len(paths), 'file')}; give clouds with points"
            )
        grid = None
        if sheets is not None:
            grid = read_sheets(Path(sheets), sheet_field, _wkt(infos))
            notes += grid.notes
        measured, cell_m = _measure(children, infos, specification, folder, grid, memory)
    limits = {} if specification is None else specification.limits
    notes += _notes(measured)
    separation = measured.separation
    written: list[str] = []
    if difference is not None:
        limit_m = limits.get("swath_difference", USUAL_LIMIT_M)
        written = _write_differences(difference, infos, separation, limit_m, memory, notes)
    rows = [
        _judged(row, row.find(measured), limits.get(row.name))
        for row in ROWS
        if row is not MISSING_SHEETS or grid is not None or row.name in limits
    ]
    summary: AcceptanceSummary = {
        "clouds": [str(path) for path in paths],
        "points": sum(file.points for file in measured.files),
        "specification": None if specification is None else specification.name,
        "cell_m": cell_m,
        "met": all(row["state"] in ("pass", "not asked") for row in rows),
        "rows": rows,
        "swath_pairs": [] if isinstance(separation, str) else separation.pairs,
        "difference": written[0] if written else None,
        "style": written[1] if len(written) > 1 else None,
        "page": None if page is None else str(page),
        "notes": notes,
    }
    if page is not None:
        write_whole(page, acceptance_page(summary))
    return summary


@contextmanager
def _remedies_of_check() -> Iterator[None]:
    """Name the remedies of a check: more memory, and no salvage, whose points would be judged as all of a file."""
    try:
        yield
    except InputError as error:
        if isinstance(error.__cause__, ChildMemoryError):
            given, remedy = AGAIN, "give more with --memory"
        elif SALVAGE in str(error):
            given, remedy = SALVAGE, AGAIN
        else:
            raise
        raise InputError(str(error).replace(given, remedy)) from error


def _write_differences(
    path: Path,
    infos: Sequence[SourceInfo],
    separation: Separation | str,
    limit_m: float,
    memory: int,
    notes: list[str],
) -> list[str]:
    """Write the raster of differences and its style, note what is not written, and return the written files."""
    # Child processes do not need its libraries.
    from tiler.apps.acceptance.difference_raster import write_differences, write_style

    if isinstance(separation, str):
        reason: str | None = separation
    else:
        reason = write_differences(path, separation, _wkt(infos), memory)
    if reason is not None:
        older = "; the file that is there is older" if path.exists() else ""
        notes.append(f"{path}: was not written: {reason}{older}")
        return []
    style = path.with_suffix(".qml")
    if not write_style(style, limit_m):
        notes.append(f"{style}: was kept, because it is not a style of this command")
        return [str(path)]
    return [str(path), str(style)]


def _wkt(infos: Sequence[SourceInfo]) -> str | None:
    """Return the CRS of the first file that has one."""
    return next((info.georeference.wkt for info in infos if info.georeference.wkt), None)


def _judged(row: Row, found: Found, asked: Any) -> AcceptanceRow:
    if asked is None:
        state = "not asked"
    elif found.value is None:
        state = "pass" if found.has_nothing else "not measured"
    elif row.limit == "only":
        state = "pass" if set(found.value) <= set(asked) else "fail"
    elif row.limit == "at least":
        state = "pass" if found.value >= asked else "fail"
    else:
        state = "pass" if found.value <= asked else "fail"
    return {
        "name": row.name,
        "unit": row.unit,
        "limit": row.limit,
        "asked": asked,
        "found": found.value,
        "state": state,
        "where": found.where,
        "remark": found.remark,
    }


def _notes(measured: Measurements) -> list[str]:
    notes = [measured.strays] if measured.strays else []
    if too_high := measured.total(lambda file: file.too_high):
        notes.append(
            f"{counted(too_high, 'single return')} with heights beyond {MAX_HEIGHT_M:,} m left out of the "
            "differences of swaths"
        )
    if not isinstance(measured.separation, str) and (pairs := measured.separation.uncompared):
        notes.append(
            f"swaths overlap without a cell that can be compared: {listed(pairs, MAX_NAMES, 'pairs')}"
        )
    if measured.without_crs:
        names = listed([str(path) for path in measured.without_crs], 3, "files")
        notes.append(
            f"no CRS, coordinates are assumed to be in metres or like those of the other files: {names}"
        )
    if not isinstance(measured.cells, str) and (n_random := measured.cells.n_random):
        notes.append(
            f"{n_random:,} point source ids look random, as almost no cell has a neighbour with points of the same id: "
            "rows per swath were left out"
        )
    if not isinstance(measured.cells, str) and measured.cells.voids:
        notes.append(
            "data voids may be water or dark surfaces, which points alone do not tell apart from missing data; look at "
            "the places"
        )
        if measured.cells.void_share > MOST_LEFT_OUT:
            notes.append(
                f"wide data voids are {measured.cells.void_share:.0%} of the survey, so density and distribution "
                "include them"
            )
    return notes


def _measure(
    children: ChildPool,
    infos: Sequence[SourceInfo],
    specification: Specification | None,
    folder: Path,
    grid: Sheets | None,
    memory: int,
) -> tuple[Measurements, float | None]:
    """Return the measurements, and the side of the cells in metres, None without cells.

    Temporary files are written to ``folder``.
    """
    for info in infos:
        _validate_crs(info)
    crs_names = _different_crs(infos, 0)
    metres = float(
        next((i.georeference.horizontal for i in infos if i.georeference.horizontal), METRE)
    )
    asked = None if specification is None else specification.pulse_spacing_m
    spacing = asked or _spacing_by_headers(infos) * metres
    plans = _digest_plans(folder, infos)
    cells = None if len(crs_names) > 1 else _cells(infos, spacing / metres)
    files = _count(children, infos, cells, plans, metres)
    duplicates = _duplicates(plans, files)
    limits = {} if specification is None else specification.limits
    of_cells, survey = files, None
    findings: CellFindings | str = DIFFERENT_CRS
    for n_counts in range(1, MAX_COUNTS + 1):
        if cells is None:
            break
        survey = survey_of(of_cells, cells)
        findings = _examined(survey, cells, metres, limits.get("pulse_density"), memory)
        better = None if asked else _better_spacing(findings, spacing)
        if better is None or n_counts == MAX_COUNTS:
            break
        spacing = better
        cells = _cells(infos, spacing / metres)
        of_cells = _count(children, infos, cells, [None] * len(infos), metres)
    vertical_names = _different_crs(infos, 1)
    separation, precision = _of_heights(
        of_cells,
        cells,
        metres,
        _reason_without_swaths(files, findings, len(vertical_names)),
        memory,
    )
    measured = Measurements(
        files,
        [info.path for info in infos if info.georeference.kind == "missing"],
        crs_names,
        vertical_names,
        [info.path for info in infos if split_wkt(info.georeference.wkt)[1] is None],
        findings,
        separation,
        precision,
        sum(duplicates.values()),
        [path for path, number in duplicates.items() if number],
        _coverage(survey, cells, grid, findings),
        survey.note if survey is not None else "",
    )
    return measured, None if isinstance(findings, str) else findings.side_m


def _validate_crs(info: SourceInfo) -> None:
    """Raise InputError if coordinates are angles."""
    crs = info.georeference
    if crs.kind in ("geographic", "geocentric"):
        raise InputError(
            f"{info.path}: CRS {crs.name} is {crs.kind}, not projected; reproject the file to a projected CRS"
        )
    if crs.kind == "missing" and info.points:
        validate_lengths(info, "write their CRS into the file")


def _different_crs(infos: Sequence[SourceInfo], part: int) -> list[str]:
    """Return the names of the different horizontal (0) or vertical (1) CRSs, sorted. A name may come twice."""
    found: list[CRS] = []
    for wkt in sorted({i.georeference.wkt for i in infos if i.georeference.wkt is not None}):
        crs = split_wkt(wkt)[part]
        is_same = same_horizontal if part == 0 else CRS.__eq__
        if crs is not None and not any(is_same(crs, other) for other in found):
            found.append(crs)
    return sorted(crs_name(crs.to_wkt()) for crs in found)


def _spacing_by_headers(infos: Sequence[SourceInfo]) -> float:
    """Return the mean spacing of all points in the bounds of the files, in units of the CRS."""
    boxes = np.array([info.bounds for info in infos if info.bounds is not None])
    sides = boxes[:, 3:5] - boxes[:, :2]
    union = boxes[:, 3:5].max(axis=0) - boxes[:, :2].min(axis=0)
    area = min(float(union.prod()), float(sides.prod(axis=1).sum()))
    return math.sqrt(area / sum(info.points for info in infos)) or 1.0


def _cells(infos: Sequence[SourceInfo], spacing: float) -> Cells:
    """Return cells for a pulse spacing in units of the CRS, around the middle of most places in all files."""
    boxes = [(patch.x0, patch.y0, patch.x1, patch.y1) for i in infos for patch in i.patches]
    if not boxes:
        bounds = (info.bounds for info in infos if info.bounds is not None)
        boxes = [(west, south, east, north) for west, south, _, east, north, _ in bounds]
    # A stray moves the middle of the bounds.
    middle = np.median(np.array(boxes).reshape(-1, 2, 2).mean(axis=1), axis=0)
    return Cells.around(float(middle[0]), float(middle[1]), SPACINGS_PER_CELL * spacing)


def _better_spacing(findings: CellFindings | str, spacing: float) -> float | None:
    """Return the measured pulse spacing in metres if the one of the headers is too far from it."""
    if isinstance(findings, str) or not findings.per_m2:
        return None
    found = 1 / math.sqrt(findings.per_m2)
    return found if max(found / spacing, spacing / found) > SIDE_TOLERANCE else None


def _count(
    children: ChildPool,
    infos: Sequence[SourceInfo],
    cells: Cells | None,
    plans: Sequence[DigestPlan | None],
    metres: float,
) -> list[FileCounts]:
    def count(guard: ChildProcess, item: tuple[SourceInfo, DigestPlan | None]) -> FileCounts:
        info, plan = item
        crs = info.georeference
        unit_m = float(crs.horizontal or metres)
        units_m = unit_m, float(crs.vertical or unit_m)
        return read_in_child(guard, count_file, info.path, cells, plan, units_m)

    return [result() for result in children.each(count, zip(infos, plans, strict=True))]


def _examined(
    survey: Survey, cells: Cells, metres: float, asked: float | None, memory: int
) -> CellFindings | str:
    """Return what the cells of all files show, or why they cannot be examined."""
    if survey.is_apart:
        return FAR_APART
    if not survey.keys.size:
        return "no first return that is not withheld"
    needed = needed_bytes(survey.keys)
    if needed > memory:
        return (
            f"the extent has too many cells of {cells.side * metres:.3g} m for the memory of a process "
            f"({needed / 1e9:,.1f} GB are needed); give more with --memory, give parts of the survey, or withhold "
            "points far from it"
        )
    return examine_cells(survey.keys, survey.counts, cells, metres, asked)


def _reason_without_swaths(
    files: Sequence[FileCounts], findings: CellFindings | str, n_vertical_crs: int
) -> str:
    """Return why the heights of swaths are not compared, empty if they are."""
    if n_vertical_crs > 1:
        return DIFFERENT_VERTICAL_CRS
    if not any(source for file in files for source in file.sources):
        return WITHOUT_SOURCES
    is_random = not isinstance(findings, str) and findings.n_random
    return RANDOM_SOURCES if is_random else ""


def _of_heights(
    files: Sequence[FileCounts],
    cells: Cells | None,
    metres: float,
    reason: str,
    memory: int,
) -> tuple[Separation | str, tuple[list[Precision], list[int]] | str]:
    """Return the differences and the repeatability of the swaths of all files, or the ``reason`` why not."""
    if cells is None:
        return DIFFERENT_CRS, DIFFERENT_CRS
    keys, sums = merged((file.height_keys, file.height_sums) for file in files)
    reason = reason or too_large(keys.size, memory)
    if reason:
        return reason, reason
    sums = sums.reshape(-1, N_SUMS)  # There may be none.
    lattice = cells.of_heights
    surfaces = find_surfaces(keys, sums, lattice.side * metres)
    precision = repeatability(keys, sums, surfaces[1], lattice)
    found = separate_swaths(keys, sums, cells, metres, memory, surfaces)
    if found != NO_OVERLAP:
        return found, precision
    if n_without := sum(file.sources.get(0, 0) for file in files):
        found = (
            f"no overlap of swaths, but {counted(n_without, 'point')} without a point source id"
        )
    elif share_cells(merged((file.keys, file.counts) for file in files)[0]):
        found = "no single returns of two swaths in the same cell, although they overlap"
    return found, precision


def _coverage(
    survey: Survey | None,
    cells: Cells | None,
    grid: Sheets | None,
    findings: CellFindings | str,
) -> Coverage | str:
    """Return the sheets that are not covered, or why they are not known."""
    if grid is None:
        return "no sheets were given (--sheets)"
    if survey is None or cells is None or isinstance(findings, str):
        return str(findings)
    spacing_m = 1 / math.sqrt(findings.per_m2) if findings.per_m2 else findings.side_m
    return covered_sheets(grid, survey.keys, cells, spacing_m * cells.side / findings.side_m)


def _digest_plans(folder: Path, infos: Sequence[SourceInfo]) -> list[DigestPlan]:
    """Return for each file where its digests are kept, and the bounds of the others that its own bounds touch."""
    boxes = [
        None
        if info.bounds is None
        else (
            info.bounds[0] - BOUNDS_MARGIN,
            info.bounds[1] - BOUNDS_MARGIN,
            info.bounds[3] + BOUNDS_MARGIN,
            info.bounds[4] + BOUNDS_MARGIN,
        )
        for info in infos
    ]
    n_parts = number_of_parts(sum(info.points for info in infos))
    plans = []
    for number, box in enumerate(boxes):
        others = tuple(
            other
            for i, other in enumerate(boxes)
            if i != number and box is not None and other is not None and _touch(box, other)
        )
        plans.append(DigestPlan(folder, str(number), n_parts, others))
    return plans


def _touch(a: Sequence[float], b: Sequence[float]) -> bool:
    return a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]


def _duplicates(plans: Sequence[DigestPlan], files: Sequence[FileCounts]) -> dict[Path, int]:
    """Return the number of points of each file that equal another one."""
    found = {file.path: file.duplicates for file in files}
    shared = [DigestFiles(p.folder, f"shared-{p.name}", p.n_shared_parts) for p in plans]
    for part in range(plans[0].n_shared_parts):
        digests = [read_digests(of_file.path(part)) for of_file in shared]
        owner = np.repeat(np.arange(len(digests)), [len(d) for d in digests])
        again = repeated(np.concatenate(digests))
        for number, n in enumerate(np.bincount(owner[again], minlength=len(files))):
            found[files[number].path] += int(n)
    return found
