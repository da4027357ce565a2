"""Features of vector files: geometry and attributes, in the CRS of the file or in that of the run.

What comes from elsewhere is read in a child process: callers go through `tiler.schedule.read_apart`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from tiler.core.units import FARTHEST
from tiler.errors import InputError
from tiler.io.vector.opening import check_file, reading
from tiler.io.vector.reprojection import in_crs
from tiler.redaction import printable

HEIGHT_COLUMNS = ("z", "h", "height", "elevation", "elev", "ele", "altitude")
"""Names of attributes that hold the height of a feature drawn in two dimensions, in lower case."""


@dataclass(frozen=True)
class Kind:
    """Geometries that a file should hold.

    Attributes
    ----------
    name : str
        Plural, as messages have it.
    types : frozenset of str
        Names of geometry types as shapely has them.
    """

    name: str
    types: frozenset[str]


POINTS = Kind("points", frozenset({"Point"}))
LINES = Kind("lines", frozenset({"LineString", "MultiLineString"}))
POLYGONS = Kind("polygons", frozenset({"Polygon", "MultiPolygon"}))
LINES_AND_POLYGONS = Kind("lines or polygons", LINES.types | POLYGONS.types)


@dataclass(frozen=True)
class Feature:
    """One feature.

    Attributes
    ----------
    place : str
        For messages: file, layer and number of the feature, counted from 1.
    geometry : shapely geometry
        Not empty; with z only where the file has it, in the file's vertical unit.
    attributes : dict
        By name in lower case; None where a feature has no value.
    """

    place: str
    geometry: BaseGeometry
    attributes: dict[str, Any]

    def height(self) -> float | None:
        """The number in the first column that is named as a height; None where there is none."""
        for name in HEIGHT_COLUMNS:
            value = self.attributes.get(name)
            if isinstance(value, int | float) and not isinstance(value, bool):
                return float(value)
        return None


@dataclass(frozen=True)
class Features:
    """What a file holds of one kind.

    Attributes
    ----------
    features : tuple of Feature
        In the order of the file.
    crs : str or None
        WKT or authority code of the geometries; None if it is unknown.
    notes : tuple of str
        What was decided, each naming the file.
    """

    features: tuple[Feature, ...]
    crs: str | None
    notes: tuple[str, ...] = ()


def read_features(path: Path, kind: Kind, every_layer: bool = False) -> Features:
    """The features of a file as it has them; those without a geometry are left out.

    Parameters
    ----------
    path : Path
        ``.gpkg``, ``.geojson``, ``.json``, ``.shp`` or ``.fgb``.
    kind : Kind
        Any other geometry in a layer that is read is an error.
    every_layer : bool
        Read all layers that may hold this kind, which have to share a CRS; else there must be exactly one.

    Raises
    ------
    InputError
        One line that names the file, and the layer and feature where it is about one, and a remedy.
    """
    import pyogrio
    from pyogrio import raw

    present = check_file(path, kind.name)
    features: list[Feature] = []
    systems: list[str | None] = []
    notes: list[str] = []
    for name in _layers(path, kind, every_layer):
        with reading(path) as told:
            pyogrio.set_gdal_config_options({"OGR_GEOMETRY_ACCEPT_UNCLOSED_RING": "YES"})
            meta, _, shapes, columns = raw.read(path, layer=name)
            titles = [str(title).lower() for title in meta["fields"]]
            rows = zip(*(c.tolist() for c in columns), strict=True) if columns else [()] * len(shapes)
            records = list(zip(shapes, (dict(zip(titles, r, strict=True)) for r in rows), strict=True))
        notes += [f"{path}: {printable(name)}: {text}" for text in told]
        if empty := sum(shape is None for shape in shapes):
            # GDAL does not tell the two apart.
            left = f"{empty} features without a geometry, or with a damaged one, are left out"
            notes.append(f"{path}: {printable(name)}: {left}")
        features += _features(f"{path}: {printable(name)}", records, kind, present)
        systems.append(meta["crs"])
    if len(set(systems)) > 1:
        raise InputError(f"{path}: its layers of {kind.name} have different CRS; write them with one")
    if not features:
        raise InputError(f"{path}: holds no {kind.name}; draw some, or leave the option out")
    return Features(tuple(features), systems[0], tuple(notes))


def _layers(path: Path, kind: Kind, every: bool) -> list[str]:
    """Names of the layers that may hold such geometries."""
    import pyogrio

    with reading(path):
        listed = [(str(name), str(shape)) for name, shape in pyogrio.list_layers(path)]
    names = [name for name, shape in listed if shape == "Unknown" or _plain_type(shape) in kind.types]
    if not names or (len(names) > 1 and not every):
        found = ", ".join(f"{printable(name)} ({shape})" for name, shape in listed) or "none"
        raise InputError(
            f"{path}: needs one layer of {kind.name}, has {len(names)} ({found}); "
            f"write one with `ogr2ogr {kind.name.split()[0]}.gpkg FILE LAYER`"
        )
    return names


def _plain_type(shape: str) -> str:
    """A geometry type without what says its dimensions: ``2.5D Point``, ``Measured 3D Polygon``, ``Point Z``."""
    return next((word for word in shape.split() if word not in ("2.5D", "3D", "Measured")), shape)


def _features(
    place: str, records: list[tuple[Any, dict[str, Any]]], kind: Kind, present: list[bool] | None
) -> Iterator[Feature]:
    """Features whose geometries are whole and of a kind; raises InputError.

    ``present`` says of which records the file holds a geometry: one that is there, and still none, is damaged.
    """
    for number, (shape, attributes) in enumerate(records, start=1):
        where = f"{place}, feature {number}"
        if shape is None and present is not None and present[number - 1]:
            raise InputError(f"{where}: its geometry is damaged; draw it again")
        if shape is None:
            continue
        try:
            with np.errstate(invalid="ignore"):  # of places that are no numbers, which are refused below
                geometry = shapely.from_wkb(shape, on_invalid="fix")  # rings that are not closed
        except shapely.errors.GEOSException as error:
            said = " ".join(str(error).split())[:100]
            raise InputError(f"{where}: its geometry is damaged ({said}); draw it again") from error
        if geometry is None:
            raise InputError(f"{where}: its geometry is damaged; draw it again")
        if geometry.is_empty:
            continue
        if geometry.geom_type not in kind.types:
            raise InputError(
                f"{where}: is a {geometry.geom_type}; {kind.name} are wanted: write them to a file of their own"
            )
        places = shapely.get_coordinates(geometry)
        if not np.isfinite(places).all():
            raise InputError(f"{where}: has a place that is no number; draw it again")
        if np.abs(places).max() >= FARTHEST:
            raise InputError(
                f"{where}: has a place farther away than {FARTHEST:g}; write coordinates of its CRS"
            )
        yield Feature(where, geometry, {k: _plain(v) for k, v in attributes.items()})


def _plain(value: Any) -> Any:
    """None for what is missing, in place of NaN."""
    return None if isinstance(value, float) and value != value else value


def read_in_crs(
    path: Path, kind: Kind, wkt: str | None, every_layer: bool = False, needs_z: bool = False
) -> Features:
    """The features of a file in the horizontal CRS of a run, polygons mended.

    Parameters
    ----------
    path, kind, every_layer
        As those of `read_features`.
    wkt : str or None
        CRS of the run; None if it is unknown.
    needs_z : bool
        Every place has to have a height: its own, or that in a column of its feature (see `HEIGHT_COLUMNS`), which is
        then given to all its places. Heights are not converted.

    Returns
    -------
    Features
        `crs` is ``wkt``; the notes tell of another CRS and of polygons that were mended.

    Raises
    ------
    InputError
        As `read_features`; no CRS where the run has one; no height where one is needed.
    """
    found = read_features(path, kind, every_layer)
    notes, features = list(found.notes), list(found.features)
    if needs_z:
        features = [_with_heights(feature) for feature in features]
    features = _mended(path, features, notes)
    moved = in_crs(path, [f.geometry for f in features], found.crs, wkt, notes)
    features = [replace(f, geometry=g) for f, g in zip(features, moved, strict=True)]
    return Features(tuple(features), wkt, tuple(notes))


def _with_heights(feature: Feature) -> Feature:
    """The feature with a height at every place; raises InputError."""
    geometry = feature.geometry
    if geometry.has_z and np.isfinite(shapely.get_coordinates(geometry, include_z=True)[:, 2]).all():
        return feature
    height = feature.height()
    if height is None:
        raise InputError(f"{feature.place}: has no heights; draw it in 3D, or give it a column `z`")
    return replace(feature, geometry=shapely.force_3d(shapely.force_2d(geometry), height))


def _mended(path: Path, features: list[Feature], notes: list[str]) -> list[Feature]:
    """Features whose polygons are valid: a place is inside where it is by an odd number of crossings."""
    polygons = [f.geometry.geom_type in POLYGONS.types for f in features]
    broken = [i for i, f in enumerate(features) if polygons[i] and not shapely.is_valid(f.geometry)]
    mended = list(features)
    for i in broken:
        parts = shapely.get_parts(shapely.get_parts(shapely.make_valid(features[i].geometry)))
        areas = [part for part in parts if part.geom_type == "Polygon" and not part.is_empty]
        if not areas:
            raise InputError(f"{features[i].place}: holds no place; draw it wider")
        mended[i] = replace(features[i], geometry=areas[0] if len(areas) == 1 else shapely.union_all(areas))
    if broken:
        notes.append(f"{path}: {len(broken)} of {sum(polygons)} polygons crossed themselves and were mended")
    return mended


def tell_outside(path: Path, features: Features, extent: tuple[float, float, float, float]) -> list[str]:
    """A warning where features lie wholly outside of the survey.

    Parameters
    ----------
    extent : (west, south, east, north)
        Of the survey, in units of the features' CRS.
    """
    survey = shapely.box(*extent)
    outside = [f for f in features.features if not shapely.intersects(survey, f.geometry)]
    if not outside:
        return []
    return [
        f"{path}: {len(outside)} of {len(features.features)} features lie outside of the survey and do nothing, "
        f"the first is {outside[0].place.removeprefix(f'{path}: ')}"
    ]
