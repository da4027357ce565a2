"""Features of vector files: geometry and attributes, in the CRS of the file or of the run.

Callers use `tiler.schedule.call_isolated`, which reads files in a child process, since files
may be malicious.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from tiler.core.area import Area, segmentized
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.units import FARTHEST
from tiler.errors import InputError
from tiler.io.vector.opening import check_file, reading, unchanged
from tiler.io.vector.reprojection import in_crs
from tiler.redaction import printable

HEIGHT_COLUMNS = ("z", "h", "height", "elevation", "elev", "ele", "altitude")
"""Names of attributes with the height of a feature that is drawn in two dimensions, in lower
case."""
SIMPLIFY = "simplify it (`ogr2ogr -simplify`, Simplify in QGIS), or divide it"
MAX_PASSED = 1e9
"""Limit of the number of edge pairs to test in a polygon: its vertices times the ratio of
outline to width."""


@dataclass(frozen=True)
class Kind:
    """Kind of the geometries that a file should contain.

    Attributes
    ----------
    name : str
        Plural name for messages.
    types : frozenset of str
        Geometry types of shapely.
    point_layers : frozenset of str
        Names of point layers that are read as well.
    left_out : frozenset of str
        Names of layers that are not read.
    """

    name: str
    types: frozenset[str]
    point_layers: frozenset[str] = frozenset()
    left_out: frozenset[str] = frozenset()

    def takes_layer(self, name: str, shape: str) -> bool:
        """Return whether a layer with the type ``shape`` may contain geometries of this kind."""
        if name in self.left_out:
            return False
        if name in self.point_layers:
            return True
        return shape == "Unknown" or _plain_type(shape) in self.types

    def takes(self, layer: str, shape: str) -> bool:
        """Return whether geometries of the type ``shape`` are read from a layer."""
        return shape in self.types or (layer in self.point_layers and shape in POINTS.types)


POINTS = Kind("points", frozenset({"Point"}))
LINES = Kind("lines", frozenset({"LineString", "MultiLineString"}))
POLYGONS = Kind("polygons", frozenset({"Polygon", "MultiPolygon"}))
LINES_AND_POLYGONS = Kind("lines or polygons", LINES.types | POLYGONS.types)


@dataclass(frozen=True)
class Feature:
    """Feature of a vector file.

    Attributes
    ----------
    place : str
        File, layer and number of the feature (the first is 1), for messages.
    geometry : shapely geometry
        Geometry, which is not empty. It has z if the file has z, in the vertical unit of the file.
    attributes : mapping
        Attributes by name in lower case, with None for missing values.
    layer : str
        Name of the layer.
    """

    place: str
    geometry: BaseGeometry
    attributes: Mapping[str, object]
    layer: str = ""

    def height(self) -> float | None:
        """Return the number in the first of the `HEIGHT_COLUMNS` with a number, or None if there is none."""
        for name in HEIGHT_COLUMNS:
            value = self.attributes.get(name)
            if isinstance(value, int | float) and not isinstance(value, bool):
                return float(value)
        return None


@dataclass(frozen=True)
class Features:
    """Features of a file that have one kind of geometry.

    Attributes
    ----------
    features : tuple of Feature
        Features in the order of the file.
    crs : str or None
        WKT or authority code of the geometries, or None if it is unknown.
    notes : tuple of str
        Notes for the user, which name the file.
    """

    features: tuple[Feature, ...]
    crs: str | None
    notes: tuple[str, ...] = ()


def read_features(
    path: Path, kind: Kind, every_layer: bool = False, may_be_empty: bool = False
) -> Features:
    """Read the features of a file. Features without a geometry are left out.

    Parameters
    ----------
    path : Path
        ``.gpkg``, ``.geojson``, ``.json``, ``.shp`` or ``.fgb``.
    kind : Kind
        Kind of the geometries. Another kind in a layer that is read is an error.
    every_layer : bool
        Whether to read all layers that may contain this kind, which must share a CRS. If False, there must be exactly
        one layer.
    may_be_empty : bool
        Whether a file without features is no error.

    Raises
    ------
    InputError
        The file cannot be read. The message contains the file, a layer and a feature if known, and a remedy.
    """
    import pyogrio
    from pyogrio import raw

    present = check_file(path, kind.name)
    features: list[Feature] = []
    systems: list[str | None] = []
    notes: list[str] = []
    with unchanged(path) as source:
        for name in _layers(path, source, kind, every_layer):
            with reading(path) as warned:
                pyogrio.set_gdal_config_options({"OGR_GEOMETRY_ACCEPT_UNCLOSED_RING": "YES"})
                meta, _, shapes, columns = raw.read(source, layer=name)
                titles = [str(title).lower() for title in meta["fields"]]
                rows: Iterable[tuple[Any, ...]] = [()] * len(shapes)
                if columns:
                    rows = zip(*(column.tolist() for column in columns), strict=True)
                attributes = [dict(zip(titles, row, strict=True)) for row in rows]
                records = list(zip(shapes, attributes, strict=True))
            notes += [f"{path}: {printable(name)}: {text}" for text in warned]
            empty = sum(shape is None for shape in shapes)
            if empty:
                # GDAL does not distinguish missing and damaged geometries.
                left = (
                    f"{empty} features without a geometry, or with a damaged one, are left out"
                )
                notes.append(f"{path}: {printable(name)}: {left}")
            features += _features(f"{path}: {printable(name)}", records, kind, present, name)
            systems.append(meta["crs"])
    if len(set(systems)) > 1:
        raise InputError(
            f"{path}: its layers of {kind.name} have different CRS; write them with the same CRS"
        )
    if not features and not may_be_empty:
        raise InputError(f"{path}: contains no {kind.name}; draw some, or leave the option out")
    return Features(tuple(features), systems[0], tuple(notes))


def _layers(path: Path, source: Path, kind: Kind, every: bool) -> list[str]:
    """Return the names of the layers of ``source``, a copy of ``path``, that may contain geometries of a kind."""
    import pyogrio

    with reading(path):
        listed = [(str(name), str(shape)) for name, shape in pyogrio.list_layers(source)]
    names = [name for name, shape in listed if kind.takes_layer(name, shape)]
    if not names or (len(names) > 1 and not every):
        listing = ", ".join(f"{printable(name)} ({shape})" for name, shape in listed) or "none"
        remedy = f"give a file with {kind.name}"
        if names:
            remedy = f"write one with `ogr2ogr {kind.name.split()[0]}.gpkg FILE LAYER`"
        raise InputError(
            f"{path}: needs one layer of {kind.name}, has {len(names)} ({listing}); {remedy}"
        )
    return names


def _plain_type(shape: str) -> str:
    """Return a geometry type without dimensions: ``Point`` for ``2.5D Point``, ``Measured 3D Point``, ``Point Z``."""
    return next(
        (word for word in shape.split() if word not in ("2.5D", "3D", "Measured")), shape
    )


def _features(
    place: str,
    records: Sequence[tuple[Any, Mapping[str, object]]],
    kind: Kind,
    present: list[bool] | None,
    layer: str,
) -> Iterator[Feature]:
    """Make features of records, and check their geometries. Raise InputError if a geometry is wrong.

    ``present`` marks the records with a geometry in the file. If GDAL returns no geometry for one of these, the
    geometry is damaged.
    """
    for number, (shape, attributes) in enumerate(records, start=1):
        where = f"{place}, feature {number}"
        if shape is None and present is not None and present[number - 1]:
            raise InputError(f"{where}: its geometry is damaged; draw it again")
        if shape is None:
            continue
        try:
            # Coordinates that are not finite are refused below.
            with np.errstate(invalid="ignore"):
                geometry = shapely.from_wkb(shape, on_invalid="fix")  # This closes open rings.
        except shapely.errors.GEOSException as error:
            said = " ".join(str(error).split())[:100]
            raise InputError(
                f"{where}: its geometry is damaged ({said}); draw it again"
            ) from error
        if geometry is None:
            raise InputError(f"{where}: its geometry is damaged; draw it again")
        if geometry.is_empty:
            continue
        if not kind.takes(layer, geometry.geom_type):
            raise InputError(
                f"{where} is a {geometry.geom_type}; {kind.name} are needed: write them to a separate file"
            )
        coordinates = shapely.get_coordinates(geometry)
        if not np.isfinite(coordinates).all():
            raise InputError(f"{where}: has a coordinate that is not a number; draw it again")
        if np.abs(coordinates).max() >= FARTHEST:
            raise InputError(
                f"{where}: has a coordinate beyond {FARTHEST:g}; use coordinates in its CRS"
            )
        # NaN represents a missing value.
        present_values = {
            k: None if isinstance(v, float) and v != v else v for k, v in attributes.items()
        }
        yield Feature(where, geometry, present_values, layer)


def read_in_crs(
    path: Path,
    kind: Kind,
    wkt: str | None,
    every_layer: bool = False,
    needs_z: bool = False,
    may_be_empty: bool = False,
) -> Features:
    """Read the features of a file, transform them to the horizontal CRS of a run, and repair invalid polygons.

    Parameters
    ----------
    path, kind, every_layer, may_be_empty
        See `read_features`.
    wkt : str or None
        CRS of the run, or None if it is unknown.
    needs_z : bool
        Whether every vertex needs a height. If one vertex has none, all get the height in a column of the feature (see
        `HEIGHT_COLUMNS`). Heights are not converted.

    Returns
    -------
    Features
        Features whose `crs` is ``wkt``, with notes about a transformation and about repaired polygons.

    Raises
    ------
    InputError
        `read_features` or the transformation failed, or a height is missing.
    """
    file_features = read_features(path, kind, every_layer, may_be_empty)
    notes = list(file_features.notes)
    features = list(file_features.features)
    if needs_z:
        features = [_with_heights(feature) for feature in features]
    features = _repaired(path, features, notes)
    moved = in_crs(path, [f.geometry for f in features], file_features.crs, wkt, notes)
    features = [replace(f, geometry=g) for f, g in zip(features, moved, strict=True)]
    return Features(tuple(features), wkt, tuple(notes))


def _validate_no_spikes(features: list[Feature]) -> None:
    """Raise InputError for a polygon with too many spikes, for which a test for crossings would not end."""
    shapes = np.array([f.geometry for f in features], object)
    vertices = shapely.get_num_coordinates(shapes)
    lengths = shapely.length(shapes)
    west, south, east, north = shapely.bounds(shapes).T
    across = lengths / np.maximum(np.maximum(east - west, north - south), 1e-9)
    for i in np.flatnonzero(vertices * across > MAX_PASSED):
        raise InputError(
            f"{features[i].place}: its outline of {vertices[i]:,} vertices runs across it {across[i]:,.0f} times; "
            f"{SIMPLIFY}"
        )


def _with_heights(feature: Feature) -> Feature:
    """Return the feature with a height at every vertex. Raise InputError if it has no height."""
    geometry = feature.geometry
    if (
        geometry.has_z
        and np.isfinite(shapely.get_coordinates(geometry, include_z=True)[:, 2]).all()
    ):
        return feature
    height = feature.height()
    if height is None:
        raise InputError(
            f"{feature.place}: has no heights; draw it in 3D, or give it a column `z`"
        )
    return replace(feature, geometry=shapely.force_3d(shapely.force_2d(geometry), height))


def _repaired(path: Path, features: list[Feature], notes: list[str]) -> list[Feature]:
    """Return the features with valid polygons.

    A position is inside a repaired polygon if a ray from it crosses the outline an odd number
    of times.
    """
    polygons = [
        i for i, feature in enumerate(features) if feature.geometry.geom_type in POLYGONS.types
    ]
    _validate_no_spikes([features[i] for i in polygons])
    broken = [i for i in polygons if not shapely.is_valid(features[i].geometry)]
    repaired = list(features)
    for i in broken:
        try:
            valid = shapely.make_valid(features[i].geometry)
        except shapely.errors.GEOSException as error:  # GEOS ran out of memory.
            raise InputError(
                f"{features[i].place}: its outline crosses itself too often to be repaired; {SIMPLIFY}"
            ) from error
        parts = shapely.get_parts(shapely.get_parts(valid))
        areas = [part for part in parts if part.geom_type == "Polygon" and not part.is_empty]
        if not areas:
            raise InputError(f"{features[i].place}: has no area; draw it wider")
        area = areas[0] if len(areas) == 1 else shapely.union_all(areas)
        repaired[i] = replace(features[i], geometry=area)
    if broken:
        notes.append(
            f"{path}: {len(broken)} of {len(polygons)} polygons crossed themselves and were repaired"
        )
    return repaired


def warn_outside(
    path: Path, features: Features, extent: tuple[float, float, float, float]
) -> list[str]:
    """Return a warning if features lie completely outside the survey, else an empty list.

    Parameters
    ----------
    path : Path
    features : Features
    extent : (west, south, east, north)
        Bounds of the survey, in units of the features' CRS.
    """
    survey = shapely.box(*extent)
    outside = [f for f in features.features if not shapely.intersects(survey, f.geometry)]
    if not outside:
        return []
    return [
        f"{path}: {len(outside)} of {len(features.features)} features lie outside the survey and have no effect, "
        f"the first is {outside[0].place.removeprefix(f'{path}: ')}"
    ]


def read_area(path: Path, wkt: str | None) -> tuple[Area, list[str]]:
    """Return the polygons of a file in absolute counts of a CRS, and notes for the user.

    Raise InputError if the file cannot be read or its polygons have no area.
    """
    polygons = read_in_crs(path, POLYGONS, wkt)
    return area_in_counts(str(path), polygons.features), list(polygons.notes)


def area_in_counts(place: str, features: Sequence[Feature]) -> Area:
    """Return the polygons of features in absolute counts.

    Raise InputError, which names the file ``place``, if they have no area or a coordinate is
    too large.
    """
    geometries = [feature.geometry for feature in features]
    if np.abs(shapely.bounds(geometries)).max() >= FARTHEST:
        raise InputError(
            f"{place}: has a coordinate beyond {FARTHEST:g}; use coordinates in its CRS"
        )
    polygons = []
    for polygon in shapely.get_parts(geometries):
        rings = (polygon.exterior, *polygon.interiors)
        corners = [shapely.get_coordinates(ring)[:-1] * COUNTS_PER_UNIT for ring in rings]
        polygons.append(tuple(segmentized(np.rint(at).astype(np.int64)) for at in corners))
    area = Area(tuple(polygons))
    if area.bounds.empty:
        raise InputError(f"{place}: its polygons have no area; draw them wider")
    return area
