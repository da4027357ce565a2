"""Descriptions of a cloud, a tile store, a result folder or a raster."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tiler.core.crs import crs_name, crs_warnings
from tiler.core.units import unit_label
from tiler.errors import InputError, StoreAccessError, StoreError
from tiler.io.cloud_formats import SUFFIXES
from tiler.io.foreign_content import parse_json_object
from tiler.io.locations import (
    as_path,
    is_url,
    joined,
    reading_remedy,
    state_at,
    storage_errors,
    without_query,
)
from tiler.io.result_folder import AGAIN_WITHOUT_RUN, RUN, STORE, read_run

if TYPE_CHECKING:
    from tiler.store import Commits, TileStore

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
"""Keys of run.json that are copied to the description of a result."""


def describe(path: str) -> dict[str, Any]:
    """Describe the cloud, store, result or raster at a path.

    Parameters
    ----------
    path : str
        Path or URL of a cloud, an ``ept.json``, a tile store, a result folder of a run, or a raster.

    Returns
    -------
    dict
        Values that JSON can represent. ``kind`` is ``cloud``, ``store``, ``result`` or ``raster``. Coordinates are in
        units of the CRS, densities in points per square metre.

    Raises
    ------
    InputError
        There is no file or folder, or it is not a cloud, store, result or raster.
    StoreError
        There is no store at a URL, another version wrote it, or it is damaged.
    """
    location = as_path(path)
    name = without_query(path).lower()
    try:
        with storage_errors():
            # On a web server, the test for a folder would read the whole cloud. Reading it
            # reports a missing one.
            is_cloud = is_url(path) and name.endswith((*SUFFIXES, "ept.json"))
            missing = not is_cloud and (
                state_at(path) is None if is_url(path) else not location.exists()
            )
            is_folder = not missing and not is_cloud and location.is_dir()
    except OSError as error:
        # Many servers refuse a folder, but not the files in it.
        if (described := _described_at(path)) is not None:
            return described
        remedy = reading_remedy(path, "give a readable file or folder")
        raise InputError(
            f"{path}: cannot be read ({error.strerror or error}); {remedy}"
        ) from error
    if missing and is_url(path):
        return _described_at(path) or describe_store(path)
    if missing:
        raise InputError(
            f"{path}: no such file or folder; give a cloud, a store, a result folder or a raster"
        )
    if is_folder:
        return _describe_folder(location)
    if name.endswith("ept.json"):
        from tiler.apps.clouds import describe_point_tiles
        from tiler.inputs import read_list

        return read_list(path, describe_point_tiles, path)
    if not name.endswith(SUFFIXES):
        from tiler.schedule import call_isolated, half_of_memory

        return call_isolated(
            describe_raster, location, paths=(location,), memory_bytes=half_of_memory()
        )
    from tiler.apps.clouds import describe_cloud
    from tiler.inputs import read_in_child
    from tiler.schedule import ChildProcess

    with ChildProcess() as guard:
        return read_in_child(guard, describe_cloud, location)


def _described_at(url: str) -> dict[str, Any] | None:
    """Return the description of a result or a store at a URL, or None if there is none."""
    from tiler.store import store_exists

    if read_run(url) is not None:
        return describe_result(as_path(url))
    try:
        return describe_store(url) if store_exists(url) else None
    except StoreAccessError:
        return None


def _describe_folder(folder: Path) -> dict[str, Any]:
    if (folder / "zarr.json").is_file():
        return describe_store(str(folder))
    if (folder / RUN).is_file():
        return describe_result(folder)
    if any(path.suffix.lower() in SUFFIXES for path in folder.iterdir()):
        raise InputError(
            f"{folder}: holds clouds; give one of them, or see `tiler plan` for all"
        )
    raise InputError(
        f"{folder}: neither a tile store nor a result folder; give a cloud, a raster, or OUT of a run"
    )


def describe_store(url: str) -> dict[str, Any]:
    """Describe a tile store: its contents, and the progress of its run."""
    from tiler.store import open_store

    store = open_store(url)
    frame = store.meta.frame
    buckets, usage = store.buckets(), store.usage()
    return {
        "kind": "store",
        "url": url,
        "size_bytes": usage.size_bytes,
        "objects": usage.objects,
        "crs": crs_name(frame.crs_wkt),
        "horizontal_unit": unit_label(frame.units.horizontal),
        "vertical_unit": unit_label(frame.units.vertical),
        "bucket_m": float(store.meta.bucket.size * frame.metres_xy),
        "buckets": len(buckets),
        "points": sum(info.n for info in buckets.values()),
        "candidates": sum(info.n_candidates for info in buckets.values()),
        "has_rgb": store.meta.has_rgb,
        "tasks_done": {stage: len(done) for stage, done in _commits(store).items() if done},
    }


def _commits(store: TileStore) -> dict[str, Commits]:
    passes = (f"filter{number}" for number in range(store.get_state("passes") or 0))
    stages = ("spool", "assemble", *passes, "grid-dtm", "export")
    return {stage: store.committed(stage) for stage in stages}


def describe_result(folder: Path) -> dict[str, Any]:
    """Describe the OUT of a run from its run.json, and from its store if it still exists."""
    from tiler.report.problems import kinds_text
    from tiler.report.runfile import run_file_errors
    from tiler.report.sections import length, share_with_height, surveyed_text
    from tiler.store import store_exists

    try:
        run = parse_json_object((folder / RUN).read_text("utf-8"))
    except OSError as error:
        raise InputError(
            f"{folder / RUN}: cannot be read ({error.strerror}); check its permissions"
        ) from error
    except ValueError as error:
        raise InputError(
            f"{folder / RUN}: not valid JSON ({error}); {AGAIN_WITHOUT_RUN}"
        ) from error
    description: dict[str, Any] = {
        "kind": "result",
        "path": str(folder),
        **{name: run.get(name) for name in _RUN_FACTS},
    }
    with run_file_errors(folder):
        if isinstance(run.get("problems"), list):
            description["problems"] = kinds_text(run["problems"]) if run["problems"] else "none"
        if terrain := run.get("dtm"):
            description["dtm"] = {**terrain, "pixel": length(run, terrain["resolution_m"])}
            if run.get("voids"):
                share = share_with_height(run["voids"])
                description["dtm"]["surveyed"] = f"{share} of {surveyed_text(run)}"
    store = joined(str(folder), STORE)
    if store_exists(store):
        try:
            description["store"] = describe_store(store)
        except StoreError as error:
            description["store"] = {"unreadable": str(error)}
    return description


def describe_raster(path: Path) -> dict[str, Any]:
    """Describe a raster: its extent, its units, and the heights of its first band."""
    from tiler.apps.evaluate.rasters import open_raster

    with open_raster(path, "neither a cloud nor a raster that can be read") as raster:
        wkt = raster.crs.to_wkt() if raster.crs else None
        # A VRT is a small text, and its pixels are in other files.
        is_vrt = raster.driver == "VRT"
        sources = [Path(file) for file in raster.files[1:]] if is_vrt else []
        files = [file for file in sources if file.is_file()]
        return {
            "kind": "raster",
            "path": str(path),
            "size_bytes": sum(file.stat().st_size for file in [path, *files]),
            **({"source_files": len(sources)} if sources else {}),
            "driver": raster.driver,
            "width": raster.width,
            "height": raster.height,
            "bands": raster.count,
            "dtype": raster.dtypes[0],
            "crs": crs_name(wkt),
            "bounds": list(raster.bounds),
            "pixel_size": list(raster.res),
            "vertical_unit": raster.units[0],
            "nodata": raster.nodata,
            "overviews": raster.overviews(1),
            "compression": None
            if is_vrt
            else (raster.compression.value.lower() if raster.compression else "none"),
            "heights": _heights(raster),
            "tags": dict(raster.tags()),
            "warnings": crs_warnings(wkt, raster.bounds),
        }


def _heights(raster: Any) -> dict[str, float]:
    """Return statistics of the first band's valid pixels, with one block in memory at a time."""
    from tiler.apps.evaluate.rasters import blocks_with_files
    from tiler.export.rasters import Statistics

    windows = (
        ((row, row + high), (col, col + wide))
        for row, col, high, wide in blocks_with_files(raster)
    )
    if raster.driver != "VRT":
        windows = (window for _, window in raster.block_windows(1))
    statistics = Statistics()
    for window in windows:
        values = raster.read(1, window=window, masked=True).compressed()
        statistics = statistics.merged(values[np.isfinite(values)], nodata=None)
    if statistics.n == 0:
        return {"valid": 0.0}
    return {
        "valid": statistics.n / (raster.width * raster.height),
        "minimum": statistics.low,
        "maximum": statistics.high,
        "mean": statistics.mean,
        "deviation": math.sqrt(statistics.squares / statistics.n),
    }
