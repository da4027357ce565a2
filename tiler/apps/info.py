"""What a cloud, a tile store, a result folder or a raster holds, as plain facts."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tiler.core.units import unit_label
from tiler.errors import InputError, StoreError
from tiler.io.json_text import read_object
from tiler.io.locations import cloud_path, is_url, joined, state_at, without_query
from tiler.io.result_folder import RUN, STORE, read_run

if TYPE_CHECKING:
    from tiler.store import TileStore

_CLOUDS = (".las", ".laz")
_POINTS_PER_CELL = 16
_MOST_CELLS = 1024
"""Mean points of a cell, and most cells along a side, of the raster that measures how much of the extent is filled."""

_MAP_COLUMNS, _MAP_ROWS = 64, 24
"""Size of the density map at most, in characters."""

_RUN_FACTS = (
    "state",
    "version",
    "counts",
    "filter",
    "dtm",
    "outputs",
    "quarantined",
    "failed_tasks",
    "seconds",
    "peak_rss_bytes",
)
"""What the description of a result tells of its run.json; the rest is to be read there."""


def describe(path: str) -> dict[str, Any]:
    """Say what is at a place.

    Parameters
    ----------
    path : str
        Path or URL of a LAS or LAZ file, a tile store, a result folder of a run, or a raster.

    Returns
    -------
    dict
        JSON-able; ``kind`` is ``cloud``, ``store``, ``result`` or ``raster``. Coordinates are in units of the
        CRS, densities in points per square metre.

    Raises
    ------
    InputError
        Nothing is there, or nothing that tiler knows.
    StoreError
        A store that this version did not write.
    """
    place = cloud_path(path)
    if is_url(path) and state_at(path) is None:
        return describe_result(place) if read_run(path) is not None else describe_store(path)
    if not place.exists():
        raise InputError(
            f"{path}: no such file or folder; name a cloud, a store, a result folder or a raster"
        )
    if place.is_dir():
        return _describe_folder(place)
    if not without_query(path).lower().endswith(_CLOUDS):
        from tiler.schedule import half_of_memory, read_apart

        return read_apart(describe_raster, place, paths=(place,), memory_bytes=half_of_memory())
    from tiler.ingest import read_guarded
    from tiler.schedule import Guard

    with Guard() as guard:
        return read_guarded(guard, describe_cloud, place)


def _describe_folder(folder: Path) -> dict[str, Any]:
    if (folder / "zarr.json").is_file():
        return describe_store(str(folder))
    if (folder / RUN).is_file():
        return describe_result(folder)
    if any(path.suffix.lower() in _CLOUDS for path in folder.iterdir()):
        raise InputError(f"{folder}: holds clouds; name one of them, or see `tiler plan` for all")
    raise InputError(
        f"{folder}: neither a tile store nor a result folder; name a cloud, a raster, or OUT of a run"
    )


def describe_cloud(path: Path) -> dict[str, Any]:
    """Facts of a LAS or LAZ file: its header as far as it is true, its units, density and classes."""
    from tiler.ingest import inspect

    info = inspect(path)
    place = info.georeference
    facts = {
        "kind": "cloud",
        "path": str(path),
        "size_bytes": info.size,
        "format": f"{'LAZ' if info.compressed else 'LAS'}{', COPC' if info.copc else ''}",
        "las_version": info.version,
        "point_format": info.point_format,
        "points": info.points,
        "bounds": list(info.bounds) if info.bounds else None,
        "scales": list(info.scales),
        "crs": place.name or "none",
        "crs_kind": place.kind,
        "horizontal_unit": unit_label(place.horizontal) if place.horizontal else "unknown",
        "vertical_unit": unit_label(place.vertical) if place.vertical else "not declared",
    }
    metres = float(place.horizontal or 1)
    return {**facts, **_point_facts(path, info.bounds, metres), "notes": list(info.notes)}


def _point_facts(path: Path, bounds: tuple[float, ...] | None, metres: float) -> dict[str, Any]:
    """Density, classes, returns and flags, from all points; one piece is in memory at a time."""
    from tiler.core.classes import SYNTHETIC_FLAG, WITHHELD_FLAG
    from tiler.io.las.columns import class_and_flags, coordinate
    from tiler.io.las.headers import read_header
    from tiler.io.las.reader import NEEDED, PointReader

    if bounds is None:
        return {}
    header = read_header(path)
    classes, flagged = np.zeros(256, np.int64), np.zeros(256, np.int64)
    x0, y0, _, x1, y1, _ = bounds
    extent, longer = (x1 - x0) * (y1 - y0), max(x1 - x0, y1 - y0)
    cell = max(math.sqrt(extent * _POINTS_PER_CELL / header.point_count), longer / _MOST_CELLS) or 1.0
    last = int(longer / cell)
    counts = np.zeros((last + 1, last + 1), np.int64)
    with PointReader(header, NEEDED) as reader:
        for records in reader.pieces():
            codes, flags = class_and_flags(records, header.point_format)
            classes += np.bincount(codes, minlength=256)
            flagged += np.bincount(flags, minlength=256)
            column, row = (
                np.clip((coordinate(records, header, axis) - low) / cell, 0, last).astype(np.intp)
                for axis, low in enumerate((x0, y0))
            )
            counts += np.bincount(row * (last + 1) + column, minlength=counts.size).reshape(counts.shape)
    area = min(int(np.count_nonzero(counts)) * cell**2, extent) * metres**2
    bits = np.arange(256)
    return {
        "density_per_m2": header.point_count / area if area > 0 else None,
        "density_map": density_map(counts, cell * metres),
        "classes": {str(c): int(n) for c, n in enumerate(classes) if n},
        "withheld_points": int(flagged[(bits & WITHHELD_FLAG) > 0].sum()),
        "synthetic_points": int(flagged[(bits & SYNTHETIC_FLAG) > 0].sum()),
    }


def density_map(counts: npt.NDArray[np.int64], cell_m: float) -> dict[str, Any]:
    """Density in places as high as two are wide, which is how a terminal's characters are.

    Parameters
    ----------
    counts : int64, shape (rows, columns)
        Points in square cells, row 0 in the south.
    cell_m : float
        Side of a cell, metres.

    Returns
    -------
    dict
        ``width_m`` and ``height_m`` of a place, ``per_m2``: rows from north to south of points per square metre.
    """
    filled = np.argwhere(counts)
    high, wide = filled.max(axis=0) + 1 if len(filled) else (1, 1)
    times = max(math.ceil(wide / _MAP_COLUMNS), math.ceil(high / (2 * _MAP_ROWS)))
    rows, columns = math.ceil(high / (2 * times)), math.ceil(wide / times)
    padded = np.zeros((rows * 2 * times, columns * times), np.int64)
    padded[:high, :wide] = counts[:high, :wide]
    sums = padded.reshape(rows, 2 * times, columns, times).sum(axis=(1, 3))[::-1]
    width = times * cell_m
    return {"width_m": width, "height_m": 2 * width, "per_m2": (sums / (2 * width**2)).round(3).tolist()}


def describe_store(url: str) -> dict[str, Any]:
    """Facts of a tile store: what it is about, and how far its run is."""
    from tiler.store import open_store

    store = open_store(url)
    frame = store.meta.frame
    buckets, usage = store.buckets(), store.usage()
    return {
        "kind": "store",
        "url": url,
        "size_bytes": usage.size_bytes,
        "objects": usage.objects,
        "crs": _crs_name(frame.crs_wkt),
        "horizontal_unit": unit_label(frame.units.horizontal),
        "vertical_unit": unit_label(frame.units.vertical),
        "bucket_m": float(store.meta.bucket.size * frame.metres_xy),
        "buckets": len(buckets),
        "points": sum(info.n for info in buckets.values()),
        "candidates": sum(info.n_candidates for info in buckets.values()),
        "has_rgb": store.meta.has_rgb,
        "tasks_done": {stage: len(done) for stage, done in _commits(store).items() if done},
    }


def _commits(store: TileStore) -> dict[str, Any]:
    """Stage -> its commits, in the order of a run; the filter has one stage a pass."""
    found = {stage: store.committed(stage) for stage in ("spool", "assemble")}
    for number in range(store.get_state("passes") or 0):  # of some passes there are none: they did not apply
        found[f"filter{number}"] = store.committed(f"filter{number}")
    return found | {stage: store.committed(stage) for stage in ("grid-dtm", "export")}


def describe_result(folder: Path) -> dict[str, Any]:
    """Facts of the OUT of a run: its run.json, and its store where it is still there."""
    from tiler.store import store_exists

    try:
        run = read_object((folder / RUN).read_text("utf-8"))
    except OSError as error:
        raise InputError(f"{folder / RUN}: cannot be read ({error.strerror}); see to its rights") from error
    except ValueError as error:
        raise InputError(f"{folder / RUN}: not valid JSON ({error}); run the same command again") from error
    facts: dict[str, Any] = {
        "kind": "result",
        "path": str(folder),
        **{name: run.get(name) for name in _RUN_FACTS},
    }
    store = joined(str(folder), STORE)
    if store_exists(store):
        try:
            facts["store"] = describe_store(store)
        except StoreError as error:
            facts["store"] = {"unreadable": str(error)}
    return facts


def describe_raster(path: Path) -> dict[str, Any]:
    """Facts of a raster: place, units, and of its first band the heights, read block by block."""
    from tiler.apps.evaluate.rasters import open_raster

    with open_raster(path, "neither a cloud nor a raster that can be read") as raster:
        return {
            "kind": "raster",
            "path": str(path),
            "size_bytes": path.stat().st_size,
            "driver": raster.driver,
            "width": raster.width,
            "height": raster.height,
            "bands": raster.count,
            "dtype": raster.dtypes[0],
            "crs": _crs_name(raster.crs.to_wkt() if raster.crs else None),
            "bounds": list(raster.bounds),
            "pixel_size": list(raster.res),
            "vertical_unit": raster.units[0],
            "nodata": raster.nodata,
            "overviews": raster.overviews(1),
            "compression": raster.compression.value.lower() if raster.compression else "none",
            "heights": _heights(raster),
            "tags": dict(raster.tags()),
        }


def _heights(raster: Any) -> dict[str, Any]:
    """Statistics of the first band's valid pixels; one block is in memory at a time."""
    count, total, squares, low, high = 0, 0.0, 0.0, math.inf, -math.inf
    from tiler.apps.evaluate.heights import blocks_with_files

    windows = (((row, row + high), (col, col + wide)) for row, col, high, wide in blocks_with_files(raster))
    if raster.driver != "VRT":
        windows = (window for _, window in raster.block_windows(1))
    for window in windows:
        block = raster.read(1, window=window, masked=True)
        values = block.compressed().astype(np.float64)
        values = values[np.isfinite(values)]
        if values.size:
            count += values.size
            total += float(values.sum())
            squares += float((values**2).sum())
            low, high = min(low, float(values.min())), max(high, float(values.max()))
    pixels = raster.width * raster.height
    if count == 0:
        return {"valid": 0.0}
    mean = total / count
    deviation = math.sqrt(max(squares / count - mean**2, 0.0))
    return {"valid": count / pixels, "minimum": low, "maximum": high, "mean": mean, "deviation": deviation}


def _crs_name(wkt: str | None) -> str:
    if wkt is None:
        return "none"
    from pyproj import CRS

    crs = CRS.from_user_input(wkt)
    code = crs.to_authority(min_confidence=100)
    return f"{crs.name} ({':'.join(code)})" if code else crs.name
