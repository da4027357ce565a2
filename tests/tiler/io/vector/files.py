"""Small vector files, written by GDAL or as GeoJSON text."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from pyogrio import raw


def collection(*geometries: dict[str, Any] | None) -> dict[str, Any]:
    """A GeoJSON FeatureCollection."""
    features = [
        {"type": "Feature", "properties": {}, "geometry": geometry} for geometry in geometries
    ]
    return {"type": "FeatureCollection", "features": features}


def write(
    path: Path,
    geometries: Sequence[Any],
    kind: str = "Unknown",
    crs: str | None = "EPSG:25832",
    columns: dict[str, Any] | None = None,
    layer: str = "l0",
    append: bool = False,
) -> Path:
    """Write a file in the format of its suffix; geometries are shapely's, well-known binary, or None."""
    shapes = np.empty(len(geometries), object)
    shapes[:] = [
        g if g is None or isinstance(g, bytes) else shapely.to_wkb(g) for g in geometries
    ]
    driver = {".gpkg": "GPKG", ".shp": "ESRI Shapefile", ".fgb": "FlatGeobuf"}[path.suffix]
    named = {} if driver != "GPKG" else {"layer": layer}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # GDAL warns of a missing CRS
        raw.write(
            path,
            shapes,
            [np.array(v) for v in (columns or {}).values()],
            list(columns or {}),
            driver=driver,
            geometry_type=kind,
            crs=crs,
            append=append,
            **named,
        )
    return path
