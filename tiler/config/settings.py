"""The settings of a run: one frozen dataclass, the only home of their defaults, help texts and units.

The command line, ``tiler config --template`` and the documentation are generated from the metadata of the fields.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from fractions import Fraction
from functools import partial
from typing import Any

from tiler.config.parsing import parse_value, plain_value
from tiler.config.presets import preset_names
from tiler.config.sources import over_preset
from tiler.core.products import DRAWN, NODATA, PRODUCTS
from tiler.core.reclass import ALL, ONLY_GROUND
from tiler.core.selection import DROP_WITHHELD, KEEP_WITHHELD, Selection
from tiler.core.sheet_names import DEFAULT as SHEET_NAME
from tiler.errors import ConfigError

# Values of `RunConfig.water` that are not names of files.
NO_WATER = "none"
AUTO_WATER = "auto"

# Values of `RunConfig.water_low`.
LOW_AS_NOISE = "noise"
KEEP_LOW = "keep"

# Values of `RunConfig.canopy`.
FILL_CANOPY = "fill"
VOID_CANOPY = "void"


UNITS = {"length": "m", "area": "m2", "bytes": "bytes"}
"""Units by kind of setting."""


def setting(
    default: Any, help: str, *, unit: str = "", kind: str = "text", choices: tuple[str, ...] = ()
) -> Any:
    """A field of `RunConfig` with its help, unit and kind; a text with ``choices`` must be one of them."""
    if choices and kind == "text":
        kind = "choice"
    metadata = {"help": help, "unit": unit or UNITS.get(kind, ""), "kind": kind, "choices": choices}
    return field(default=default, metadata=metadata)


# Kinds that several settings have.
length = partial(setting, kind="length")
area = partial(setting, kind="area")
flag = partial(setting, kind="flag")
whole = partial(setting, kind="int")
classes = partial(setting, kind="classes")
file = partial(setting, kind="file")
files = partial(setting, kind="files")


@dataclass(frozen=True)
class RunConfig:
    """All settings of a run; ``None`` means that tiler decides from the data, and reports the decision."""

    preset: str | None = setting(
        None,
        f"settings to start from: {', '.join(preset_names())}; those of --config and then those of the command line "
        "win; `tiler config --preset NAME` shows them",
        kind="preset",
    )
    method: str = setting("auto", "ground filter (see `tiler methods`); `keep` trusts the input's classes")
    parameters: tuple[tuple[str, str], ...] = setting(
        (), "parameters of the method, name=value (`tiler methods NAME` lists them)", kind="pairs"
    )
    ground_classes: tuple[int, ...] = classes(
        (2,), "classes of the input that `--method keep` takes as ground"
    )
    products: tuple[str, ...] = setting(
        ("dtm",),
        "rasters to write, each as OUT/<name>.tif: dtm, dsm (surface), ndsm (surface above the terrain), hillshade, "
        "slope (degrees), density (ground points per m2), distance (to the nearest ground point, m), sigma (standard "
        "error of the heights, in their unit), mask (where heights come from); as OUT/<name>.gpkg: contours (lines), "
        "spots (tops and bottoms)",
        kind="names",
        choices=(*PRODUCTS, *DRAWN),
    )
    sheets: Fraction | None = length(
        None,
        "side of the sheets into which each product is cut: files OUT/<product>/<sheet-name>.tif below "
        "OUT/<product>.vrt, listed in OUT/sheets.gpkg; default: one file",
    )
    sheet_name: str = setting(
        SHEET_NAME,
        "name of a sheet's file without its ending; fields: name (product), x and y (west and south edge), east and "
        "north, in units of the CRS, and x_km, y_km, east_km, north_km in thousands of them; a field may have a "
        "format: {x_km:04.0f}",
        kind="template",
    )
    empty_sheets: bool = flag(False, "also write sheets that hold points but no heights")
    resolution: Fraction | None = length(
        None,
        "pixel size; default 1 m, or the spacing of the points where that is coarser; 0.1, 0.25 or 0.5 m for matched "
        "clouds with about ten points or more in such a pixel; in feet 2 ft instead of 1 m, else one of 0.1, 0.2, 0.5, "
        "1, 5, 10 ft",
    )
    tile_size: Fraction | None = length(None, "side of a filter tile; default from density and memory")
    halo: Fraction | None = length(None, "how far beyond its tile the filter looks; default from the method")
    max_edge: Fraction = length(
        Fraction(100),
        "a pixel has no height where the triangle of ground points around it has a longer edge, or the circle "
        "through its corners a larger radius",
    )
    interpolation: str = setting(
        "linear",
        "heights between ground points: linear on the TIN, natural neighbours, or idw (12 nearest, 1 / squared "
        "distance); all give heights to the same pixels",
        choices=("linear", "natural", "idw"),
    )
    surface: str | None = setting(
        None,
        "which ground points make the DTM: all of them, or in each cell of half a pixel the one at the median or at "
        "a percentile (p10) of the cell's heights; default: all, or the median where the cloud is taken for image "
        "matching",
        kind="surface",
    )
    erode: Fraction | None = length(
        None,
        "leave out ground points nearer than this to an object at least 1 m higher, such as stumps of walls in "
        "image matching; default: 0, or 0.5 m where the cloud is taken for image matching",
    )
    voids: str = setting(
        "leave",
        "holes inside the survey that are wider than `max-edge`: leave (no heights), fill (from their rim), or mark "
        "(fill, and write the mask)",
        choices=("leave", "fill", "mark"),
    )
    canopy: str = setting(
        FILL_CANOPY,
        "where a closed canopy hides the ground from image matching: fill (bridge it from the ground seen around it "
        "and in its openings; 6 in the mask) or void (no heights)",
        choices=(FILL_CANOPY, VOID_CANOPY),
    )
    breaklines: tuple[str, ...] = files(
        (),
        "file of lines in 3D, or with a height in a column (z, elevation), in any CRS, that the terrain follows; "
        "ground nearer to them than half a pixel is left out",
    )
    edits: str | None = file(
        None,
        "file of polygons, in any CRS, with a column `action`: not_ground (no point inside is ground), ground (the "
        "points inside that the input has as ground, or where it has none the lowest of each pixel), void (no "
        "height), flat (the height in the column z); default: none",
    )
    water: str = file(
        AUTO_WATER,
        "bodies of water, level in the terrain (lakes) or falling along their flow (rivers): none, auto (found in "
        "the data), or a file, in any CRS, with polygons, optional columns kind (lake, river) and level, and optional "
        "lines along which rivers flow",
    )
    water_low: str = setting(
        LOW_AS_NOISE,
        "class in the classified clouds of returns from more than 0.5 m below the level of water: noise (7), or keep "
        "(as other points in water)",
        choices=(LOW_AS_NOISE, KEEP_LOW),
    )
    water_min_lake: Fraction = area(
        Fraction(8000), "smallest lake or pond that `--water auto` takes (8000, 0.8ha, 2acre)"
    )
    water_min_river_width: Fraction = length(
        Fraction(15), "narrowest river or canal, by its mean width, that `--water auto` takes"
    )
    water_min_island: Fraction = area(
        Fraction(1000), "smallest island that `--water auto` keeps; smaller ones become water"
    )
    bridges: str = setting(
        "keep",
        "decks of bridges that the filter left in the terrain: keep, or remove (those that stand free, the ground 2 "
        "m lower beside both edges and a road at both ends, get class 17; OUT/bridges.gpkg shows them)",
        choices=("keep", "remove"),
    )
    contour_interval: Fraction | None = length(
        None,
        "difference of height between contours; default: a round number of the CRS's unit that gives 50 levels at "
        "most, four times the noise of the ground and 0.25 m (1 ft) at least",
    )
    contour_smooth: Fraction | None = length(
        None,
        "smooth the heights for the contours by a Gaussian of this standard deviation; 0: not at all; default: 2 "
        "pixels",
    )
    classified: str = setting(
        "laz",
        "the points with their new classes, OUT/classified: laz, las (larger, quicker to read), copc (by place, not "
        "in the order of the input: other programs draw it at once and read parts of it), or none",
        choices=("laz", "las", "copc", "none"),
    )
    outline: str = setting(
        "survey",
        "where heights end: at the survey, the places with points and gaps of up to 20 m between them (more where "
        "points are sparse), or at the hull of facets up to `max-edge`",
        choices=("survey", "hull"),
    )
    spike: Fraction = length(
        Fraction(5),
        "the DSM leaves out a pixel's highest return if it rises this far above all returns around it (next pixels, "
        "at least 1 m)",
    )
    memory: int | None = setting(
        None,
        "memory that one worker may use; default: half of that of the machine or container, divided by the workers, "
        "4 GiB at most",
        kind="bytes",
    )
    workers: int | None = whole(
        None,
        "worker processes, one thread each; default: the cores that tiler may use, fewer if memory is below 512 MiB "
        "for each",
    )
    in_process: bool = flag(
        False, "work in the command's own process, for debugging: whatever crashes it ends the run"
    )
    task_seconds: int = whole(
        600,
        "time for a task of up to a million points, in proportion for a larger one; a worker that takes longer "
        "counts as hung and is replaced",
        unit="s",
    )
    scheduler: str | None = setting(
        None, "address of a running Dask scheduler (tcp://host:8786); default: workers on this machine"
    )
    store: str | None = setting(None, "place of the tile store; default OUT/store.zarr")
    crs: str | None = setting(
        None,
        "CRS of files that have none (EPSG:..., WKT; a compound one like EPSG:2154+5720 also gives its heights' "
        "datum to files that name EPSG:2154 alone), or `none`: unknown, metres assumed; default: a file without CRS "
        "is an error",
        kind="crs",
    )
    units: str | None = setting(
        None, "units of the coordinates, h or h,v (m, ft, usft); default: those of the CRS"
    )
    bounds: tuple[float, float, float, float] | None = setting(
        None,
        "only this part: X0 Y0 X1 Y1 in CRS units; what lies around it is read as far as it matters; default: "
        "everything",
        kind="bounds",
    )
    aoi: str | None = file(
        None,
        "only what lies inside the polygons of a GeoPackage, GeoJSON or Shapefile, in any CRS; as with --bounds, "
        "what lies around them is read as far as it matters; default: everything",
    )
    keep_classes: tuple[int, ...] = classes(
        (7, 9, 17, 18),
        "classes that take no part in filtering and are never overwritten; `none`: the classes of the input are "
        "ignored, as a fair test on a labelled cloud needs",
    )
    reclass: str = setting(
        ONLY_GROUND,
        "which classes change in the classified clouds: ground (ground gets 2, low noise 7; ground of the input that "
        "is no ground gets 1, or 9 in water, or 17 on a bridge that is left out; every other class of the input "
        "stays), or all (every point that takes part gets 2, 7, 17 or 1)",
        choices=(ONLY_GROUND, ALL),
    )
    returns: str | None = setting(
        None,
        "returns that are filtered and gridded: first, last, or numbers (1, 2-4); as with the four options that "
        "follow, the classified clouds hold all points; default: all returns",
        kind="returns",
    )
    scan_angle: float | None = setting(
        None,
        "largest scan angle of points that are filtered and gridded; default: any",
        unit="degrees",
        kind="angle",
    )
    source_id: str | None = setting(
        None,
        "point source ids (flight lines) that are filtered and gridded: 12,20-31; default: all",
        kind="sources",
    )
    drop_classes: tuple[int, ...] = classes((), "classes of the input that are neither filtered nor gridded")
    withheld: str = setting(
        DROP_WITHHELD,
        "points flagged as withheld: drop (they are neither filtered nor gridded), or keep (as other points)",
        choices=(DROP_WITHHELD, KEEP_WITHHELD),
    )
    skip_synthetic: bool = flag(
        False, "points flagged as synthetic take no part in filtering and keep their class"
    )
    skip_overlap: bool = flag(
        False, "points flagged as overlap take no part in filtering and keep their class"
    )
    sigma: Fraction | None = length(
        None,
        "standard deviation of the noise of heights, for methods that need it; default: estimated from planar "
        "patches",
    )
    kind: str | None = setting(
        None,
        "what made the cloud, a laser scanner (als) or matching of images from drones or aircraft (dim), for "
        "methods that treat them differently; default: decided from the data",
        choices=("als", "dim"),
    )
    statistics: str | None = setting(
        None,
        "OUT folder of an earlier run of the same method: use the kind, density and noise that it found; "
        "default: measure those of this run's own points",
    )
    nodata: float = setting(
        NODATA,
        "value of pixels without a height in rasters of heights and slopes (-999999 for USGS; nan is possible)",
        unit="as the raster",
        kind="nodata",
    )
    compress: str = setting("deflate", "compression of rasters", choices=("deflate", "zstd"))
    on_error: str = setting(
        "skip",
        "what becomes of a broken file or tile: skip it (exit code 5), or stop the run",
        choices=("skip", "stop"),
    )
    salvage: bool = flag(False, "read what is left of a truncated file instead of leaving it out")
    verify: bool = flag(False, "read all inputs and outputs again to see whether they changed")
    overwrite: bool = flag(False, "start afresh instead of resuming with what OUT holds")
    force: bool = flag(False, "replace files in OUT that no run of this OUT wrote")
    clean_store: bool = flag(False, "remove the store when the run is done")

    @property
    def surface_percent(self) -> int | None:
        """Percentile of the heights in a cell that makes the DTM; None for all points."""
        if self.surface is None or self.surface == "all":
            return None
        if self.surface == "median":
            return 50
        return int(self.surface[1:])

    @property
    def erosion(self) -> Fraction:
        """The setting `erode`, or 0 if it is not given."""
        return Fraction(0) if self.erode is None else self.erode

    @property
    def water_file(self) -> str | None:
        """The file that `water` names; None if it is none or auto."""
        return None if self.water in (NO_WATER, AUTO_WATER) else self.water

    @property
    def source_kind(self) -> str | None:
        """The setting `kind` with the name that methods use (`ptd.passes.RunFacts`)."""
        return "lidar" if self.kind == "als" else self.kind

    @property
    def exported(self) -> tuple[str, ...]:
        """The products that become raster files."""
        marked = {"mask"} if self.voids == "mark" else set()
        return tuple(name for name in PRODUCTS if name in marked or name in self.products)

    @property
    def drawn(self) -> tuple[str, ...]:
        """The products that become vector files."""
        return tuple(name for name in DRAWN if name in self.products)

    @property
    def selection(self) -> Selection:
        """The points of the input that are filtered and gridded."""
        return Selection(
            self.returns,
            self.scan_angle,
            self.source_id,
            self.drop_classes,
            self.withheld == KEEP_WITHHELD,
        )

    def to_json(self) -> dict[str, Any]:
        """The settings as JSON-able values; `from_mapping` reads them back."""
        return {f.name: plain_value(getattr(self, f.name)) for f in fields(self)}

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any]) -> RunConfig:
        """Settings from plain values (TOML, JSON, options); unknown names and bad values raise ConfigError.

        If there is a ``preset``, settings that are not given come from it.
        """
        known = {f.name: f for f in fields(cls)}
        for name in data:
            if name not in known:
                raise ConfigError(f"unknown setting {name!r}; `tiler config --template` lists them")
        given = over_preset(data)
        return cls(**{name: parse_value(known[name], value) for name, value in given.items()})

    def updated(self, **changes: Any) -> RunConfig:
        """A copy with these fields (already parsed) replaced."""
        return dataclasses.replace(self, **changes)
