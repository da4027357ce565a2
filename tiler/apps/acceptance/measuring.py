"""Check of clouds: inspect files, count their points in child processes, and compare the rows with what is asked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
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
from tiler.apps.acceptance.counts import CellCounter, Cells, DigestPlan, FileCounts, count_file
from tiler.apps.acceptance.duplicates import (
    DigestFiles,
    number_of_parts,
    read_digests,
    repeated,
)
from tiler.apps.acceptance.rows import ROWS, Found, Measurements, Row
from tiler.apps.acceptance.specification import Specification
from tiler.apps.results import AcceptanceRow, AcceptanceSummary
from tiler.core.crs import crs_name, same_horizontal, split
from tiler.core.units import METRE
from tiler.core.words import counted, listed
from tiler.errors import InputError
from tiler.inputs import (
    SourceInfo,
    find_inputs,
    inspect_in_child,
    read_in_child,
    validate_lengths,
)
from tiler.io.atomic_files import SCRATCH_PREFIX
from tiler.schedule import ChildPool, ChildProcess, half_of_memory

MAX_CHILDREN = 8
"""Maximum number of processes that read files at the same time."""
SIDE_TOLERANCE = 1.25
"""Ratio of the sides of cells, by the headers and by the measured density, above which the points are counted again."""
BOUNDS_MARGIN = 1.0
"""Width in units of the CRS by which the bounds of a file are widened, since headers may be rounded."""

DIFFERENT_CRS = "the files have different CRSs"


def check_clouds(
    inputs: Sequence[str | Path], specification: Specification | None = None
) -> AcceptanceSummary:
    """Measure all rows of clouds, and compare them with a specification.

    Parameters
    ----------
    inputs : sequence of path
        Files, folders, globs and virtual point clouds.
    specification : Specification, optional
        What is asked. Without it, nothing is asked.

    Raises
    ------
    ConfigError
        A path does not exist.
    InputError
        A file cannot be read, its CRS has angles, or no file has points.
    """
    notes: list[str] = []
    paths = find_inputs(inputs, note=notes.append, results=True)
    n_children = min(len(paths), psutil.cpu_count() or 1, MAX_CHILDREN)
    with (
        TemporaryDirectory(prefix=SCRATCH_PREFIX) as folder,
        ChildPool(n_children, half_of_memory() // n_children) as children,
    ):
        infos = [look() for look in children.each(inspect_in_child, paths)]
        if not any(info.points for info in infos):
            raise InputError(
                f"{paths[0]}: no points in {counted(len(paths), 'file')}; give clouds with points"
            )
        measured, cell_m = _measure(children, infos, specification, Path(folder))
    limits = {} if specification is None else specification.limits
    rows = [_judged(row, row.find(measured), limits.get(row.name)) for row in ROWS]
    return {
        "clouds": [str(path) for path in paths],
        "points": sum(file.points for file in measured.files),
        "specification": None if specification is None else specification.name,
        "cell_m": cell_m,
        "met": all(row["state"] in ("pass", "not asked") for row in rows),
        "rows": rows,
        "notes": notes + _notes(measured),
    }


def _judged(row: Row, found: Found, asked: Any) -> AcceptanceRow:
    if asked is None:
        state = "not asked"
    elif found.value is None:
        state = "not measured"
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
    notes = []
    if measured.without_crs:
        names = listed([str(path) for path in measured.without_crs], 3, "files")
        notes.append(
            f"no CRS, coordinates are assumed to be in metres or like those of the other files: {names}"
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
    findings: CellFindings | str = DIFFERENT_CRS
    plans = _digest_plans(folder, infos)
    cells = None if len(crs_names) > 1 else _cells(infos, spacing / metres)
    files = _count(children, infos, cells, plans)
    duplicates = _duplicates(plans, files)
    limits = {} if specification is None else specification.limits
    if cells is not None:
        findings = _examined(files, cells, metres, limits.get("pulse_density"))
        better = None if asked else _better_spacing(findings, spacing)
        if better is not None:
            cells = _cells(infos, better / metres)
            counted_again = _count(children, infos, cells, [None] * len(infos))
            findings = _examined(counted_again, cells, metres, limits.get("pulse_density"))
    measured = Measurements(
        files,
        [info.path for info in infos if info.georeference.kind == "missing"],
        crs_names,
        _different_crs(infos, 1),
        [info.path for info in infos if not _has_vertical(info.georeference.wkt)],
        metres,
        findings,
        sum(duplicates.values()),
        [path for path, number in duplicates.items() if number],
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
        validate_lengths(info)


def _different_crs(infos: Sequence[SourceInfo], part: int) -> list[str]:
    """Return the names of the different horizontal (0) or vertical (1) CRSs, sorted. A name may come twice."""
    found: list[CRS] = []
    for wkt in sorted({i.georeference.wkt for i in infos if i.georeference.wkt is not None}):
        crs = split(CRS.from_wkt(wkt))[part]
        is_same = same_horizontal if part == 0 else CRS.__eq__
        if crs is not None and not any(is_same(crs, other) for other in found):
            found.append(crs)
    return sorted(crs_name(crs.to_wkt()) for crs in found)


def _has_vertical(wkt: str | None) -> bool:
    return wkt is not None and split(CRS.from_wkt(wkt))[1] is not None


def _spacing_by_headers(infos: Sequence[SourceInfo]) -> float:
    """Return the mean spacing of all points in the bounds of the files, in units of the CRS."""
    boxes = np.array([info.bounds for info in infos if info.bounds is not None])
    sides = boxes[:, 3:5] - boxes[:, :2]
    union = boxes[:, 3:5].max(axis=0) - boxes[:, :2].min(axis=0)
    area = min(float(union.prod()), float(sides.prod(axis=1).sum()))
    points = sum(info.points for info in infos)
    return math.sqrt(area / points) or 1.0


def _cells(infos: Sequence[SourceInfo], spacing: float) -> Cells:
    """Return cells for a pulse spacing in units of the CRS, around the middle of all files."""
    boxes = np.array([info.bounds for info in infos if info.bounds is not None])
    middle = (boxes[:, :2].min(axis=0) + boxes[:, 3:5].max(axis=0)) / 2
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
) -> list[FileCounts]:
    def count(guard: ChildProcess, item: tuple[SourceInfo, DigestPlan | None]) -> FileCounts:
        info, plan = item
        return read_in_child(guard, count_file, info.path, cells, plan)

    return [result() for result in children.each(count, zip(infos, plans, strict=True))]


def _examined(
    files: Sequence[FileCounts], cells: Cells, metres: float, asked: float | None
) -> CellFindings | str:
    """Return what the cells of all files show, or why they cannot be examined."""
    counter = CellCounter()
    for file in files:
        counter.add(file.keys, file.counts)
    keys, counts = counter.merge()
    if not keys.size:
        return "no first return that is not withheld"
    needed = needed_bytes(keys)
    if needed > half_of_memory():
        return (
            f"the extent has too many cells of {cells.side * metres:.3g} m for this machine's memory "
            f"({needed / 1e9:,.0f} GB); give parts of the survey, or withhold points far from it"
        )
    return examine_cells(keys, counts, cells, metres, asked)


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
