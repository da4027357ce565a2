"""What people draw, as files, the ground that they draw it on, and what a run made of both."""

from __future__ import annotations

import functools
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import shapely

from tests.invariants import clouds
from tests.invariants.clouds import CORNER, Cloud
from tiler.core.products import NODATA

EAST, NORTH = CORNER
Features = list[tuple[Any, dict[str, Any]]]


def draw(path: Path, features: Features) -> str:
    """A file of features in metres from `CORNER`."""
    found = []
    for shape, columns in features:
        corner = np.array([EAST, NORTH, 0])[: 3 if shape.has_z else 2]
        moved = shapely.transform(
            shape, functools.partial(np.add, corner), include_z=shape.has_z
        )
        geometry = shapely.geometry.mapping(moved)
        found.append({"type": "Feature", "properties": columns, "geometry": geometry})
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32632"}}
    path.write_text(json.dumps({"type": "FeatureCollection", "crs": crs, "features": found}))
    return str(path)


def pixels(out: Path) -> np.ndarray:
    """Heights of the DTM, rows from the south, columns from the west, both from `CORNER` on."""
    with rasterio.open(out / "dtm.tif") as raster:
        size, bounds = raster.res[0], raster.bounds
        south, west = round((bounds.bottom - NORTH) / size), round((bounds.left - EAST) / size)
        return np.pad(raster.read(1)[::-1], ((south, 0), (west, 0)), constant_values=NODATA)


def digests(out: Path) -> dict[str, str]:
    files = [*out.glob("*.tif"), *out.glob("*.gpkg"), *out.glob("classified/*")]
    return {f.name: hashlib.blake2b(f.read_bytes()).hexdigest() for f in sorted(files)}


def ground(heights: Any, side: float = 60.0, number: int = 12_000, seed: int = 3) -> Cloud:
    """Points of class 2 on a surface, whole millimetres."""
    xy = np.round(np.random.default_rng(seed).uniform(0, side, (number, 2)), 3)
    xyz = np.column_stack((xy, np.round(heights(*xy.T), 3)))
    return Cloud(xyz, np.full(number, 2, np.uint8))


def written(path: Path, cloud: Cloud) -> Path:
    return clouds.write(path, cloud, classes=cloud.truth)
