"""Polygons of a file, whatever its format."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.errors import InputError
from tiler.io.json_text import excerpt, member
from tiler.io.vector.geojson import read_features
from tiler.io.vector.geopackage import geometry_of, read_layer
from tiler.io.vector.shapefile import read_shapes

FORMATS = (".gpkg", ".geojson", ".json", ".shp")

_KINDS = ("POLYGON", "MULTIPOLYGON", "GEOMETRY")
_POLYGON, _MULTIPOLYGON = 3, 6
_LEAST_PLACES = 3

Ring = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Polygons:
    """What a file holds.

    Attributes
    ----------
    rings : list of list of float64 (n, 2)
        Rings of each polygon, holes among them, in units of the CRS; x is east or longitude.
    crs : str or None
        What the file says of itself: WKT or authority code.
    """

    rings: list[list[Ring]]
    crs: str | None


def read_polygons(path: Path | str) -> Polygons:
    """The polygons of a file; those of a multipolygon stand alone, heights and measures are left out.

    Parameters
    ----------
    path : path
        ``.gpkg``: the one layer of polygons. ``.geojson``, ``.json``: a FeatureCollection. ``.shp``: with its CRS
        in the ``.prj`` beside it.

    Raises
    ------
    InputError
        The file cannot be read, is of another format, or holds anything but polygons, or none.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise InputError(
            f"{path}: polygons are read from .gpkg, .geojson, .json and .shp files; "
            "convert it, for example with `ogr2ogr area.gpkg FILE`"
        )
    if not path.is_file():
        raise InputError(f"{path}: no such file; name a GeoPackage, GeoJSON or Shapefile with polygons")
    crs: str | None
    if suffix == ".shp":
        rings, crs = read_shapes(path)
    elif suffix == ".gpkg":
        layer = read_layer(path, _KINDS, "polygons")
        rings, crs = [], layer.crs
        for number, (blob, _) in enumerate(layer.records, start=1):
            if blob is not None:
                place = f"{path}: {layer.name}, feature {number}"
                rings += _from_binary(geometry_of(blob, place), place)
    else:
        features, crs = read_features(path, "the polygons")
        rings = [p for n, f in enumerate(features, 1) for p in _from_json(f, f"{path}: feature {n}")]
    rings = [polygon for polygon in rings if polygon]
    if not rings:
        raise InputError(f"{path}: holds no polygon")
    for number, polygon in enumerate(rings, start=1):
        for ring in polygon:
            if len(ring) < _LEAST_PLACES or not np.isfinite(ring).all():
                raise InputError(
                    f"{path}: polygon {number} has a ring of fewer than 3 places, or one that is no number"
                )
    return Polygons(rings, crs)


def _from_json(feature: dict[str, Any], place: str) -> list[list[Ring]]:
    if feature.get("geometry") is None:
        return []
    geometry = member(feature, "geometry")
    kind = geometry.get("type")
    if kind not in ("Polygon", "MultiPolygon"):
        raise InputError(f"{place}: is a {excerpt(kind) if kind else 'feature without place'}, not a Polygon")
    coordinates = geometry.get("coordinates") or []
    try:
        return [
            [np.array([[float(v) for v in p[:2]] for p in ring], np.float64).reshape(-1, 2) for ring in rings]
            for rings in ([coordinates] if kind == "Polygon" else coordinates)
        ]
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{place}: its coordinates are damaged ({error})") from error


def _from_binary(geometry: bytes, place: str) -> list[list[Ring]]:
    """The polygons of well-known binary; none of an empty one."""
    if not geometry:
        return []
    try:
        return _polygons(geometry, 0, (_POLYGON, _MULTIPOLYGON), place)[0]
    except (struct.error, ValueError, IndexError) as error:
        raise InputError(f"{place}: its geometry is damaged ({error})") from error


def _polygons(data: bytes, start: int, kinds: tuple[int, ...], place: str) -> tuple[list[list[Ring]], int]:
    """The polygons of a geometry that begins at a byte, and the byte after it."""
    order = "<" if data[start] else ">"
    code, number = struct.unpack_from(f"{order}2I", data, start + 1)
    # ISO: 1003 is a polygon with z, 2003 with a measure, 3003 with both; the older form sets the highest bits.
    form, kind = divmod(code & 0x0FFFFFFF, 1000)
    dimensions = 2 + (form in (1, 3) or bool(code & 0x80000000)) + (form in (2, 3) or bool(code & 0x40000000))
    start += 9
    if kind not in kinds:
        raise InputError(f"{place}: is no polygon (type {code})")
    found: list[list[Ring]] = []
    if kind == _MULTIPOLYGON:
        for _ in range(number):
            part, start = _polygons(data, start, (_POLYGON,), place)
            found += part
        return found, start
    rings = []
    for _ in range(number):
        (places,) = struct.unpack_from(f"{order}I", data, start)
        values = np.frombuffer(data, f"{order}f8", places * dimensions, start + 4)
        rings.append(values.reshape(-1, dimensions)[:, :2].astype(np.float64))
        start += 4 + 8 * places * dimensions
    return [rings], start
