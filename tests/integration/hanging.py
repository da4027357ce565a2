"""Foreign files that take for ever, or all memory, and the options with which commands read them."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import rasterio
from affine import Affine

ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"


def endless_geopackage(path: Path, kind: str = "POLYGON", rows: bool = False) -> Path:
    """One whose layer is a view that never ends: without a row, or with more of them for ever."""
    sign = ">" if rows else "<"
    with sqlite3.connect(path) as base:
        base.executescript(f"""
            CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT, srs_id INTEGER PRIMARY KEY, organization TEXT,
                organization_coordsys_id INTEGER, definition TEXT, description TEXT);
            INSERT INTO gpkg_spatial_ref_sys VALUES ('utm', 32632, 'EPSG', 32632, 'undefined', NULL);
            CREATE TABLE gpkg_geometry_columns (table_name TEXT, column_name TEXT, geometry_type_name TEXT,
                srs_id INTEGER, z TINYINT, m TINYINT);
            INSERT INTO gpkg_geometry_columns VALUES ('area', 'geom', '{kind}', 32632, 0, 0);
            CREATE VIEW area AS {ENDLESS} SELECT i AS fid, zeroblob(1000) AS geom FROM n WHERE i {sign} 0;
        """)
    base.close()
    return path


def huge_raster(path: Path) -> Path:
    """Four megabytes that says it is a raster of 10^12 pixels: it would be read for hours."""
    with rasterio.open(
        path, "w", driver="GTiff", width=1_000_000, height=1_000_000, count=1, dtype="uint8", nodata=0, tiled=True,
        blockxsize=2048, blockysize=2048, SPARSE_OK=True, BIGTIFF="YES", transform=Affine(1, 0, 5e5, 0, -1, 5.4e6),
    ):  # fmt: skip
        return path
