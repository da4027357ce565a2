"""Catalogues for other programs: ``classified.vpc`` (QGIS, pdal_wrench) and ``stac.json`` (STAC 1.1).

They do not contain the time or the folder of the run, so that the same content gives the same
bytes. All links are relative, so that OUT can be published without changes.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import PurePosixPath
from typing import Any
from urllib.parse import quote

from tiler.config import plain_value
from tiler.core.dates import Days, days_of, span_of
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.products import HEIGHT, PRODUCTS
from tiler.core.raster import RasterSpec
from tiler.core.records import digest_of
from tiler.core.results import SurveyDates
from tiler.core.units import unit_label
from tiler.export import stac
from tiler.export.output_files import (
    CloudRecord,
    OutFile,
    RasterFileRecord,
    write_text,
)
from tiler.export.tasks.files import nodata_of
from tiler.export.tasks.sheets import key_of, name_of
from tiler.io.las.point_formats import newer_format
from tiler.io.locations import joined
from tiler.io.result_folder import (
    BRIDGES,
    CLASSIFIED,
    CLOUD_SUFFIXES,
    OUTLINE,
    OVERVIEW,
    REPORT,
    SHEET_ITEMS,
    SHEETS,
    STAC,
    VIRTUAL,
    WATER,
    mosaic_file,
    raster_file,
    sheet_file,
)
from tiler.plan import Plan
from tiler.runs.found import Gridded, Sheet, Source
from tiler.schedule import Task, calling
from tiler.store import Commits
from tiler.version import __version__

STAGE = "catalogue"
_DIGITS = 9
"""Number of decimals of coordinates. Further decimals are rounding errors of binary
fractions."""
_SCHEMAS = "https://stac-extensions.github.io"
_POINTCLOUD = f"{_SCHEMAS}/pointcloud/v1.0.0/schema.json"
_OF_VIRTUAL = [_POINTCLOUD, f"{_SCHEMAS}/projection/v1.1.0/schema.json"]
_OF_RASTERS = [
    f"{_SCHEMAS}/projection/v2.0.0/schema.json",
    f"{_SCHEMAS}/raster/v2.0.0/schema.json",
]
_COG = "image/tiff; application=geotiff; profile=cloud-optimized"
_GPKG = "application/geopackage+sqlite3"
_VRT, _JSON, _GEOJSON = "application/xml", "application/json", "application/geo+json"
_CLOUDS = {
    "laz": ("application/vnd.laszip", "LASzip"),
    "las": ("application/vnd.las", "LAS"),
    "copc": ("application/vnd.laszip+copc", "LASzip"),
}
"""Media type and encoding of classified clouds, by the value of `--classified`."""


@dataclass(frozen=True)
class Cloud:
    """Classified cloud that was written: its path in OUT, its source, and the record of its task."""

    path: str
    source: Source
    record: CloudRecord


def written_clouds(plan: Plan, sources: Sequence[Source], written: Commits) -> list[Cloud]:
    """Return the classified clouds that were written, given the commits of the stage export."""
    clouds = []
    for source in sources:
        key = f"c{source.number:06d}"
        if key in written:
            path = f"{CLASSIFIED}/{plan.inputs.cloud_names[source.info.path].as_posix()}"
            clouds.append(Cloud(path, source, CloudRecord.of(written[key][1])))
    return clouds


def survey_dates(clouds: Sequence[Cloud], sources: Sequence[Source]) -> SurveyDates | None:
    """Return the days on which the points were measured, or else on which their files were made."""
    days, by = _days(clouds, sources)
    if (span := span_of(days)) is None:
        return None
    first, last = span
    return SurveyDates(first.isoformat(), last.isoformat(), by)


def _days(
    clouds: Sequence[Cloud], sources: Sequence[Source] = ()
) -> tuple[list[Days | None], str]:
    """Return the days of each file and their kind, of the sources if no clouds are written."""
    if not clouds:  # The plan read the times of some points of each source.
        return days_of([(source.info.times, source.info.created) for source in sources])
    return days_of(
        [(cloud.record.statistics["gps"], cloud.source.info.created) for cloud in clouds]
    )


def planned(gridding: Gridded) -> dict[str, str]:
    """Return the path in OUT of the file of each task of this stage, by the key of the task."""
    whole = (STAC, VIRTUAL) if gridding.plan.writes_clouds else (STAC,)
    cut = {
        f"{key_of(SHEET_ITEMS, sheet)}.json": _item_path(gridding, sheet)
        for sheet in gridding.sheets
    }
    return {**dict(zip(whole, whole, strict=True)), **cut}


def catalogue_tasks(
    gridding: Gridded,
    sources: Sequence[Source],
    kind: str | None,
    written: Commits,
    out: str,
    crs_code: str | None,
) -> Iterator[Task]:
    """Yield one task per file.

    Parameters
    ----------
    gridding : Gridded
    sources : sequence of Source
    kind : str or None
        Kind of the clouds, ``lidar`` or ``dim``, or None if it is not known.
    written : Commits
        Commits of the stages export and mosaic.
    out : str
        Folder or URL of the results.
    crs_code : str or None
        Code of the horizontal CRS, see `tiler.export.stac.horizontal_code`.
    """
    maker = _Catalogue(gridding, sources, kind, written, crs_code)
    keys = {path: key for key, path in planned(gridding).items()}
    for path, content in maker.documents().items():
        folder, _, name = path.rpartition("/")
        to = OutFile(joined(out, folder) if folder else out, name)
        text = json.dumps(content, indent=None if name == VIRTUAL else 1) + "\n"
        yield Task.of(STAGE, keys[path], calling(write_text, to=to, text=text))


class _Catalogue:
    """Documents of a run, with the parameters of `catalogue_tasks`."""

    def __init__(
        self,
        gridding: Gridded,
        sources: Sequence[Source],
        kind: str | None,
        written: Commits,
        crs_code: str | None,
    ) -> None:
        self._gridding, self._plan, self._written = gridding, gridding.plan, written
        self._crs_code = crs_code
        self._globe = stac.Globe(self._plan.grid.meta.frame.crs_wkt)
        self._type = "eopc" if kind == "dim" else "lidar"
        self._sources = sources
        self._suffix = CLOUD_SUFFIXES[self._plan.config.classified]
        self._media, self._encoding = _CLOUDS.get(self._plan.config.classified, ("", ""))
        self.clouds = written_clouds(self._plan, sources, written)

    def documents(self) -> dict[str, dict[str, Any]]:
        """Return the content of each document by its path in OUT."""
        documents: dict[str, dict[str, Any]] = {}
        if self._plan.writes_clouds:
            features = [
                self._virtual(cloud)
                for cloud in self.clouds
                if cloud.record.statistics["fields"]
            ]
            documents[VIRTUAL] = {"type": "FeatureCollection", "features": features}
        if self._plan.config.sheets is None:
            documents[STAC] = self._whole()
            return documents
        items = {
            _item_path(self._gridding, sheet): self._sheet(sheet)
            for sheet in self._gridding.sheets
        }
        return {**documents, STAC: self._collection(items), **items}

    def _virtual(self, cloud: Cloud) -> dict[str, Any]:
        """Return a classified cloud as a feature of the virtual cloud."""
        wkt, fields = self._plan.grid.meta.frame.crs_wkt, cloud.record.statistics["fields"]
        schema = stac.schema([self._format(cloud)])
        names = [entry["name"] for entry in schema]
        low, high = (
            [round(fields[axis][end], _DIGITS) for axis in "XYZ"]
            for end in ("minimum", "maximum")
        )
        box = (low[0], low[1], high[0], high[1])
        native = {"type": "Polygon", "coordinates": [stac.corners(box)]}
        west, south, east, north = self._globe.bbox(box) or box
        return {
            "type": "Feature", "stac_version": "1.0.0", "stac_extensions": _OF_VIRTUAL,
            "id": str(PurePosixPath(cloud.path).relative_to(CLASSIFIED)).removesuffix(self._suffix),
            "geometry": self._globe.polygon(box) or native, "bbox": [west, south, low[2], east, north, high[2]],
            "properties": {
                **stac.dates(_days([cloud])[0]), "pc:count": cloud.record.points, "pc:type": self._type,
                "pc:encoding": self._encoding, "pc:schemas": schema,
                "pc:statistics": stac.statistics(fields, cloud.record.points, names),
                **({"proj:wkt2": wkt} if wkt else {}), "proj:geometry": native, "proj:bbox": [*low, *high],
            },
            "links": [],
            "assets": {"data": _asset(cloud.path, self._media), **self._overview},
        }  # fmt: skip

    @property
    def _overview(self) -> dict[str, Any]:
        """Asset of the overview of all clouds, which QGIS takes from any feature of the virtual cloud."""
        if OVERVIEW not in self._written:
            return {}
        return {"overview": _asset(OVERVIEW, _CLOUDS["copc"][0], "overview")}

    def _format(self, cloud: Cloud) -> int:
        """Return the point format of a classified cloud."""
        point_format = cloud.source.info.point_format
        return (
            newer_format(point_format)
            if self._plan.config.classified == "copc"
            else point_format
        )

    def _whole(self) -> dict[str, Any]:
        """Return the item of a run whose products are not divided into sheets."""
        names = self._plan.config.product_name
        rasters = {
            name: (name, raster_file(name, names)) for name in self._plan.config.exported
        }
        assets = {**self._rasters(rasters, "."), **self._besides()}
        item = self._item(self._id, self._gridding.spec, assets, [])
        if self.clouds:
            item["stac_extensions"] = [*item["stac_extensions"], _POINTCLOUD]
            item["properties"] |= {
                "pc:count": sum(cloud.record.points for cloud in self.clouds), "pc:type": self._type,
                "pc:encoding": self._encoding,
                "pc:schemas": stac.schema(self._format(c) for c in self.clouds),
            }  # fmt: skip
        return item

    def _sheet(self, sheet: Sheet) -> dict[str, Any]:
        exported = self._plan.config.exported
        rasters = {
            name: (key_of(name, sheet), sheet_file(name, name_of(self._gridding, name, sheet)))
            for name in exported
        }
        own_name = "_".join(f"{edge:.10g}" for edge in sheet.spec.edges[:2])
        if sheet.drawn is not None:
            own_name = sheet.drawn.name
        rels = ("root", "parent", "collection")
        links = [{"rel": rel, "href": f"../{STAC}", "type": _JSON} for rel in rels]
        assets = {**self._rasters(rasters, ".."), **self._drawn(sheet)}
        item = self._item(f"{self._id}_{own_name}", sheet.spec, assets, links)
        return {**item, "collection": self._id}

    def _drawn(self, sheet: Sheet) -> dict[str, Any]:
        """Return the assets of the vector files of a sheet."""
        assets = {}
        for name in self._plan.config.drawn:
            path = sheet_file(name, name_of(self._gridding, name, sheet))
            if f"{key_of(name, sheet)}.gpkg" in self._written:
                assets[name] = {**_asset(path, _GPKG), "href": f"../{quote(os.fsencode(path))}"}
        return assets

    def _collection(self, items: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
        """Return the collection of the sheets."""
        boxes = [item["bbox"] for item in items.values() if "bbox" in item] or [
            (-180, -90, 180, 90)
        ]
        when = self._dates()
        interval = [when.get(f"{end}_datetime") or when["datetime"] for end in ("start", "end")]
        mosaics = {
            name: _asset(mosaic_file(name), _VRT, title=PRODUCTS[name].description)
            for name in self._plan.config.exported
            if mosaic_file(name) in self._written
        }
        return {
            "type": "Collection", "stac_version": "1.1.0", "stac_extensions": [], "id": self._id,
            "title": "Terrain in sheets", "description": self._description, "license": "other",
            "extent": {"spatial": {"bbox": [stac.hull_of(boxes)]}, "temporal": {"interval": [interval]}},
            "links": [
                {"rel": "root", "href": f"./{STAC}", "type": _JSON},
                *({"rel": "item", "href": f"./{quote(os.fsencode(path))}", "type": _GEOJSON} for path in items),
            ],
            "assets": {**mosaics, **self._besides()},
        }  # fmt: skip

    def _item(
        self,
        name: str,
        spec: RasterSpec,
        assets: Mapping[str, Any],
        links: Sequence[Mapping[str, str]],
    ) -> dict[str, Any]:
        """Return an item whose rasters have the pixels ``spec``."""
        box = _box(spec)
        bbox = self._globe.bbox(box)
        return {
            "type": "Feature", "stac_version": "1.1.0", "stac_extensions": _OF_RASTERS, "id": name,
            "geometry": self._globe.polygon(box), **({} if bbox is None else {"bbox": bbox}),
            "properties": {
                "title": "Terrain", "description": self._description, **self._dates(),
                "proj:code": self._crs_code, "proj:wkt2": self._plan.grid.meta.frame.crs_wkt,
                "proj:bbox": list(box), "proj:geometry": {"type": "Polygon", "coordinates": [stac.corners(box)]},
                "proj:shape": [spec.height, spec.width], "proj:transform": list(spec.transform(COUNTS_PER_UNIT)),
            },
            "links": list(links), "assets": dict(assets),
        }  # fmt: skip

    def _rasters(self, rasters: Mapping[str, tuple[str, str]], base: str) -> dict[str, Any]:
        """Return the assets of the rasters that were written, given their task and path by product."""
        assets = {}
        for name, (key, path) in rasters.items():
            if f"{key}.tif" in self._written:
                record = RasterFileRecord.of(self._written[f"{key}.tif"][1])
                product = PRODUCTS[name]
                assets[name] = {
                    "href": f"{base}/{quote(os.fsencode(path))}", "type": _COG, "title": product.description,
                    "roles": ["data"],
                    "bands": [self._band(name, record)],
                }  # fmt: skip
        return assets

    def _band(self, name: str, record: RasterFileRecord) -> dict[str, Any]:
        product, units = PRODUCTS[name], self._plan.grid.meta.frame.units
        nodata = nodata_of(self._plan, name)
        nodata = product.nodata if nodata is None else nodata
        unit = unit_label(units.vertical) if product.unit == HEIGHT else product.unit
        figures = {"minimum": record.min, "maximum": record.max, "mean": record.mean}
        shares = {"valid_percent": round(100 * record.valid / max(record.pixels, 1), 4)}
        return {
            "name": name, "description": product.description, "data_type": product.dtype,
            **({} if nodata is None else {"nodata": plain_value(nodata)}), **({"unit": unit} if unit else {}),
            "statistics": {**{k: v for k, v in figures.items() if v is not None}, **shares},
            "raster:sampling": "area", "raster:spatial_resolution": float(self._plan.grid.resolution),
        }  # fmt: skip

    def _besides(self) -> dict[str, Any]:
        """Return the assets that are not rasters."""
        drawn = [
            OUTLINE,
            WATER,
            BRIDGES,
            SHEETS,
            *(f"{name}.gpkg" for name in self._plan.config.drawn),
        ]
        written = [name for name in drawn if name in self._written]
        assets = {name.removesuffix(".gpkg"): _asset(name, _GPKG) for name in written}
        if self.clouds:
            assets[VIRTUAL] = _asset(
                VIRTUAL, _GEOJSON, "metadata", title="classified clouds as one"
            )
            assets |= self._overview
        for cloud in self.clouds:
            # The schema of the extension is valid only for items, and with sheets this is a
            # collection.
            more: dict[str, Any] = (
                {"pc:count": cloud.record.points} if self._plan.config.sheets is None else {}
            )
            asset = _asset(
                quote(os.fsencode(cloud.path)),
                self._media,
                title="points with their classes",
                **more,
            )
            assets[cloud.path.removesuffix(self._suffix)] = asset
        assets["report"] = _asset(REPORT, "text/html", "metadata")
        return assets

    def _dates(self) -> dict[str, str | None]:
        return stac.dates(_days(self.clouds, self._sources)[0])

    @cached_property
    def _id(self) -> str:
        """Identifier of the results of the same clouds, pixels and method, which an edit does not change."""
        contents = sorted(source.content for source in self._sources)
        pixel, method = str(self._plan.grid.resolution), self._plan.config.method
        return f"terrain-{digest_of(contents, pixel, method)[:16]}"

    @property
    def _description(self) -> str:
        pixel, method = float(self._plan.grid.resolution), self._plan.config.method
        return f"Terrain of {pixel:g} m pixels, ground by {method}, made by tiler {__version__}"


def _asset(path: str, media: str, role: str = "data", **more: Any) -> dict[str, Any]:
    """Return the asset of a file in OUT."""
    return {"href": f"./{path}", "type": media, "roles": [role], **more}


def _box(spec: RasterSpec) -> stac.Box:
    """Return the edges of a raster in units of the CRS."""
    a, _, x, _, e, y = spec.transform(COUNTS_PER_UNIT)
    return (x, y + e * spec.height, x + a * spec.width, y)


def _item_path(gridding: Gridded, sheet: Sheet) -> str:
    """Return the path in OUT of the item of a sheet."""
    return f"{SHEET_ITEMS}/{name_of(gridding, SHEET_ITEMS, sheet)}.json"
