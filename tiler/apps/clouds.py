"""Descriptions of clouds: all facts of one, from all of its points, and a table of many, from their headers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ptd.arrays import Int64
from tiler.core.crs import crs_name, crs_warnings
from tiler.core.points import SYNTHETIC_FLAG, WITHHELD_FLAG
from tiler.core.units import short_unit, unit_label
from tiler.errors import InputError
from tiler.inputs import SourceInfo, find_inputs, inspect, inspect_in_child
from tiler.inputs.lists import is_virtual
from tiler.inputs.point_tiles import node_counts, read_point_tiles
from tiler.io.cloud_formats import format_of
from tiler.io.las.headers import read_header
from tiler.io.las.point_formats import class_and_flags, coordinate
from tiler.io.las.reader import NEEDED, PointReader
from tiler.io.locations import is_url
from tiler.io.result_folder import RUN
from tiler.schedule import ChildPool

_POINTS_PER_CELL = 16
"""Mean number of points in a cell of the raster that measures the filled part of the extent."""
_MAX_CELLS = 1024
"""Maximum number of cells along a side of that raster, so that it needs only about 8 MB."""

_MAP_COLUMNS = 64
"""Maximum width of the density map in characters, so that it fits a terminal of 80 x 24."""
_MAP_ROWS = 24
"""Maximum height of the density map in characters."""


def describe_cloud(path: Path) -> dict[str, Any]:
    """Describe a cloud: its checked header, units, density and classes."""
    info = inspect(path)
    georeference = info.georeference
    cloud_format = format_of(path)
    name = f"{'LAZ' if info.compressed else 'LAS'}{', COPC' if info.copc else ''}"
    horizontal, vertical = georeference.horizontal, georeference.vertical
    return {
        "kind": "cloud",
        "path": str(path),
        "size_bytes": info.size,
        "format": name if cloud_format.is_las else cloud_format.name,
        "las_version": info.version if cloud_format.is_las else None,
        "point_format": info.point_format if cloud_format.is_las else None,
        "points": info.points,
        "bounds": list(info.bounds) if info.bounds else None,
        "scales": list(info.scales),
        "crs": georeference.name or "none",
        "crs_kind": georeference.kind,
        "horizontal_unit": unit_label(horizontal) if horizontal else "unknown",
        "vertical_unit": unit_label(vertical) if vertical else "not declared",
        **_point_facts(path, info.bounds, float(horizontal or 1)),
        "notes": list(info.notes),
        "warnings": crs_warnings(georeference.wkt, info.bounds),
    }


def _point_facts(path: Path, bounds: tuple[float, ...] | None, metres: float) -> dict[str, Any]:
    """Return density, classes and flags of all points, with one piece of them in memory at a time."""
    if bounds is None:
        return {}
    header = read_header(path)
    classes, flagged = np.zeros(256, np.int64), np.zeros(256, np.int64)
    x0, y0, _, x1, y1, _ = bounds
    extent, longer = (x1 - x0) * (y1 - y0), max(x1 - x0, y1 - y0)
    cell = (
        max(math.sqrt(extent * _POINTS_PER_CELL / header.point_count), longer / _MAX_CELLS)
        or 1.0
    )
    last = int(longer / cell)
    counts = np.zeros((last + 1, last + 1), np.int64)
    with PointReader(header, NEEDED) as reader:
        for records in reader.pieces():
            codes, flags = class_and_flags(records, header.point_format)
            classes += np.bincount(codes, minlength=256)
            flagged += np.bincount(flags, minlength=256)
            column, row = (
                np.clip((coordinate(records, header, axis) - low) / cell, 0, last).astype(
                    np.intp
                )
                for axis, low in enumerate((x0, y0))
            )
            counts += np.bincount(row * (last + 1) + column, minlength=counts.size).reshape(
                counts.shape
            )
    area = min(int(np.count_nonzero(counts)) * cell**2, extent) * metres**2
    bits = np.arange(256)
    return {
        "density_per_m2": header.point_count / area if area > 0 else None,
        "density_map": density_map(counts, cell * metres),
        "classes": {str(c): int(n) for c, n in enumerate(classes) if n},
        "withheld_points": int(flagged[(bits & WITHHELD_FLAG) > 0].sum()),
        "synthetic_points": int(flagged[(bits & SYNTHETIC_FLAG) > 0].sum()),
    }


def describe_point_tiles(path: str) -> dict[str, Any]:
    """Describe an EPT data set from its metadata and its hierarchy, without reading points."""
    tiles = read_point_tiles(path)
    counts = node_counts(tiles)
    points = sum(counts.values())
    return {
        "kind": "cloud",
        "path": path,
        "format": "EPT",
        "points": points,
        "nodes": len(counts),
        "levels": max(key[0] for key in counts) + 1,
        "bounds": list(tiles.box((0, 0, 0))),
        "crs": crs_name(tiles.wkt),
        "notes": tiles.other_total(points),
        "warnings": crs_warnings(tiles.wkt, tiles.box((0, 0, 0))),
    }


def density_map(counts: Int64, cell_m: float) -> dict[str, Any]:
    """Return the density in cells twice as high as wide, like the characters of a terminal.

    ``width_m`` and ``height_m`` are the sides of a cell, and ``per_m2`` are rows of densities in points per square
    metre, from north to south.

    Parameters
    ----------
    counts : int64, shape (rows, columns)
        Number of points in square cells, row 0 in the south.
    cell_m : float
        Side of a cell, metres.
    """
    filled = np.argwhere(counts)
    high, wide = filled.max(axis=0) + 1 if len(filled) else (1, 1)
    times = max(math.ceil(wide / _MAP_COLUMNS), math.ceil(high / (2 * _MAP_ROWS)))
    rows, columns = math.ceil(high / (2 * times)), math.ceil(wide / times)
    padded = np.zeros((rows * 2 * times, columns * times), np.int64)
    padded[:high, :wide] = counts[:high, :wide]
    sums = padded.reshape(rows, 2 * times, columns, times).sum(axis=(1, 3))[::-1]
    width = times * cell_m
    return {
        "width_m": width,
        "height_m": 2 * width,
        "per_m2": (sums / (2 * width**2)).round(3).tolist(),
    }


COLUMNS = (
    "file",
    "points",
    "per m2",
    "west",
    "south",
    "east",
    "north",
    "lowest",
    "highest",
    "unit",
    "CRS",
)
ZARR = "zarr.json"
"""Name of a file that identifies a folder as a tile store."""


def is_many(paths: Sequence[str]) -> bool:
    """Return whether paths are described in a table: several paths, or a folder, list or pattern of clouds."""
    if len(paths) != 1:
        return True
    path = Path(paths[0])
    if is_url(paths[0]) or path.is_file():
        return is_virtual(paths[0])
    if path.is_dir():
        return not ((path / RUN).is_file() or (path / ZARR).is_file())
    return any(sign in paths[0] for sign in "*?[")


@dataclass(frozen=True, kw_only=True)
class ListedCloud:
    """Cloud in the table.

    Attributes
    ----------
    path : str
    points : int
    per_m2 : float or None
        Mean density in its bounds.
    bounds : tuple of float, or None
        Lowest x, y, z, highest x, y, z in units of the CRS.
    unit, crs : str or None
    warnings : list of str
    """

    path: str
    points: int
    per_m2: float | None
    bounds: tuple[float, ...] | None
    unit: str | None
    crs: str | None
    warnings: list[str]


@dataclass(frozen=True)
class UnreadableCloud:
    """Cloud that cannot be read, and why."""

    path: str
    error: str


def describe_many(paths: Sequence[str]) -> list[ListedCloud | UnreadableCloud]:
    """Describe each cloud that is found in some files, folders, virtual point clouds and globs.

    Raises
    ------
    ConfigError
        A path does not exist.
    InputError
        There is no cloud.
    """
    descriptions: list[ListedCloud | UnreadableCloud] = []
    files = find_inputs(paths)
    with ChildPool(1) as guards:
        for path, look in zip(files, guards.each(inspect_in_child, files), strict=True):
            try:
                descriptions.append(_listed(look()))
            except InputError as error:
                descriptions.append(
                    UnreadableCloud(str(path), str(error).removeprefix(f"{path}: "))
                )
    return descriptions


def _listed(source: SourceInfo) -> ListedCloud:
    georeference = source.georeference
    metres, per_m2 = georeference.horizontal, None
    if source.bounds is not None and metres is not None:
        x0, y0, _, x1, y1, _ = source.bounds
        area = (x1 - x0) * (y1 - y0) * float(metres) ** 2
        per_m2 = source.points / area if area > 0 else None
    return ListedCloud(
        path=str(source.path),
        points=source.points,
        per_m2=per_m2,
        bounds=source.bounds,
        unit=None if metres is None else short_unit(metres),
        crs=crs_name(georeference.wkt),
        warnings=crs_warnings(georeference.wkt, source.bounds),
    )


def table_row(cloud: ListedCloud | UnreadableCloud) -> list[str]:
    """Return the row of a cloud in the table, with cells in the order of `COLUMNS`."""
    if isinstance(cloud, UnreadableCloud):
        return [cloud.path, cloud.error, *[""] * (len(COLUMNS) - 2)]
    density = "-" if cloud.per_m2 is None else f"{cloud.per_m2:.3g}"
    bounds = cloud.bounds
    bounds_texts = (
        ["-"] * 6 if bounds is None else [f"{bounds[i]:.2f}" for i in (0, 1, 3, 4, 2, 5)]
    )
    return [
        cloud.path,
        f"{cloud.points:,}",
        density,
        *bounds_texts,
        cloud.unit or "-",
        f"{cloud.crs or '-'}{', outside its area of use' if cloud.warnings else ''}",
    ]
