"""Foreign files that take for ever, or all memory, and the options with which commands read them."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import rasterio
from affine import Affine

from tests.tiler.io.vector.files import write

ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"


def endless_geopackage(path: Path, kind: str = "POLYGON") -> Path:
    """One whose layer is a view that never ends, without a row."""
    write(path, [], {"POLYGON": "Polygon", "POINT": "Point"}[kind], "EPSG:32632", layer="area")
    with sqlite3.connect(path) as base:
        for (name,) in base.execute(
            "SELECT name FROM sqlite_master WHERE type = 'trigger'"
        ).fetchall():
            base.execute(f'DROP TRIGGER "{name}"')  # they need functions of GDAL
        base.executescript(f"""
            DELETE FROM gpkg_extensions; DELETE FROM gpkg_ogr_contents; DROP TABLE rtree_area_geom; DROP TABLE area;
            CREATE VIEW area AS {ENDLESS} SELECT i AS fid, zeroblob(1000) AS geom FROM n WHERE i < 0;
        """)
    base.close()
    return path


def huge_raster(path: Path) -> Path:
    """Four megabytes that says it is a raster of 10^12 pixels: it would be read for hours."""
    size = {
        "width": 1_000_000,
        "height": 1_000_000,
        "transform": Affine(1, 0, 5e5, 0, -1, 5.4e6),
    }
    values = {"count": 1, "dtype": "uint8", "nodata": 0, "SPARSE_OK": True, "BIGTIFF": "YES"}
    blocks = {"tiled": True, "blockxsize": 2048, "blockysize": 2048}
    with rasterio.open(path, "w", driver="GTiff", **size, **values, **blocks):
        return path
