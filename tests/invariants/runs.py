"""Runs of the whole job, and what they leave in a form that compares."""

from __future__ import annotations

import hashlib
from fractions import Fraction
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import rasterio

from tiler.config import RunConfig
from tiler.core.points import unpack_origin
from tiler.pipeline import RunResult, run
from tiler.store import TileStore, open_store

MARK = 0x80
WITH_EVERY_STAGE = {
    "products": "dtm,slope,mask",
    "voids": "fill",
    "sheets": "64",
    "water": "auto",
}
"""Settings with which a run has stages of every kind."""
EVERY_STAGE = """identify spool assemble filter0 grid-dtm grid-slope grid-survey grid-domain grid-water-ground
grid-water-areas grid-dtm-outlined grid-mask sheets export mosaic""".split()  # noqa: SIM905


def settings(**changes: Any) -> RunConfig:
    """One worker, this process; tiles far smaller than the scenes; lengths as numbers of metres.

    `classic`, which has one pass, and no search for water, a third of such a run, unless said otherwise: runs by the
    hundred are quick.
    """
    values: dict[str, Any] = {
        "workers": 1,
        "resolution": "1",
        "tile_size": "64",
        "halo": "80",
        "memory": "1GiB",
        "in_process": True,
        "method": "classic",
        "water": "none",
        **changes,
    }
    return RunConfig.from_mapping(values)


def do(
    paths: Path | list[Path], out: Path | str, until: str = "export", **changes: Any
) -> RunResult:
    inputs = [paths] if isinstance(paths, Path) else paths
    return run([str(path) for path in inputs], out, settings(**changes), until=until)


def computed(result: RunResult) -> dict[str, int]:
    """Stage -> tasks that were computed in this run."""
    return {name: stage["computed"] for name, stage in result.summary["stages"].items()}


def output_digests(out: Path) -> dict[str, str]:
    """Digest of each file that people open: the DTM and the classified clouds."""
    files = [out / "dtm.tif", *sorted((out / "classified").rglob("*.laz"))]
    return {str(f.relative_to(out)): hashlib.blake2b(f.read_bytes()).hexdigest() for f in files}


def all_digests(out: Path) -> dict[str, str]:
    """Digest of every raster, VRT and cloud that a run wrote."""
    return {
        str(path.relative_to(out)): hashlib.blake2b(path.read_bytes()).hexdigest()
        for path in sorted(out.rglob("*"))
        if path.suffix in (".tif", ".vrt", ".laz") and "store.zarr" not in path.parts
    }


def dtm(out: Path) -> tuple[np.ndarray, Any]:
    """Pixels and transform."""
    with rasterio.open(out / "dtm.tif") as raster:
        return raster.read(1), raster.transform


def assert_same_terrain(out: Path, other: Path) -> None:
    """The same pixels at the same places."""
    for mine, theirs in zip(dtm(out), dtm(other), strict=True):
        assert np.asarray(mine).tobytes() == np.asarray(theirs).tobytes()


def classes_by_point(out: Path) -> np.ndarray:
    """X, Y, Z and class of all points of the classified files, int64 (n, 4), sorted."""
    rows = []
    for path in sorted((out / "classified").rglob("*.laz")):
        las = laspy.read(path)
        rows.append(
            np.stack([las.X, las.Y, las.Z, np.asarray(las.classification)], axis=1).astype(
                np.int64
            )
        )
    found = np.concatenate(rows)
    return found[np.lexsort(found.T[::-1])]


def the_store(out: Path) -> TileStore:
    return open_store(str(out / "store.zarr"))


def stored_labels(out: Path) -> tuple[np.ndarray, np.ndarray]:
    """Labels and marks in the order of source and row."""
    store = the_store(out)
    origins, labels = [], []
    for cell in store.buckets():
        origin = store.read_bucket(cell, ("origin",)).origin
        assert origin is not None
        origins.append(origin)
        labels.append(store.read_labels("labels", cell))
    order = np.argsort(np.concatenate(origins))
    found = np.concatenate(labels)[order]
    return found & ~np.uint8(MARK), (found & MARK) != 0


def rows_of(origin: np.ndarray) -> list[tuple[int, int]]:
    sources, rows = unpack_origin(origin)
    return list(zip(sources.tolist(), rows.tolist(), strict=True))


def metres(value: float) -> Fraction:
    return Fraction(value).limit_denominator(1000)
