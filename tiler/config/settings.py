"""Settings of a run: one frozen dataclass, the only definition of their defaults, help texts and units.

The command line, ``tiler config --template`` and the documentation are generated from the
metadata of the fields.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from fractions import Fraction
from functools import partial
from typing import Any

from tiler.config.parsing import parse_value, plain_value
from tiler.config.sources import load_preset, over_preset, preset_names
from tiler.core.file_names import DEFAULT, DRAWN
from tiler.core.products import (
    MAX_RESOLUTIONS,
    NODATA,
    PRODUCTS,
    PRODUCTS_HELP,
    VECTOR_PRODUCTS,
)
from tiler.core.selection import ALL, DROP_WITHHELD, KEEP_WITHHELD, ONLY_GROUND, Selection
from tiler.core.units import Sides
from tiler.errors import ConfigError

# Values of `RunConfig.water` that are not names of files.
NO_WATER = "none"
AUTO_WATER = "auto"

# Values of `RunConfig.water_low`.
LOW_AS_NOISE = "noise"
KEEP_LOW = "keep"

NEWEST = "newest"
"""Value of `RunConfig.priority` that is not the name of a file."""

# Values of `RunConfig.canopy`.
FILL_CANOPY = "fill"
VOID_CANOPY = "void"


UNITS = {"length": "m", "area": "m2", "bytes": "bytes"}
"""Default unit of each kind of setting."""


def without_folders(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings as run.json has them, with the names of files alone: clients do not see a provider's folders."""

    def name(value: Any) -> Any:
        return re.split(r"[/\\]", value.rstrip("/\\"))[-1] if isinstance(value, str) else value

    files = {
        spec.name
        for spec in fields(RunConfig)
        if spec.metadata["kind"] in ("file", "files", "sheets")
        or spec.name in ("store", "statistics")
    }
    return {
        key: ([name(v) for v in value] if isinstance(value, list) else name(value))
        if key in files
        else value
        for key, value in values.items()
    }


def setting(
    default: Any,
    help: str,
    *,
    unit: str = "",
    kind: str = "text",
    choices: tuple[str, ...] = (),
) -> Any:
    """Return a field of `RunConfig` with its help, unit and kind. A text with ``choices`` must be one of them."""
    if choices and kind == "text":
        kind = "choice"
    metadata = {
        "help": help,
        "unit": unit or UNITS.get(kind, ""),
        "kind": kind,
        "choices": choices,
    }
    return field(default=default, metadata=metadata)


# These kinds are used by several settings.
length = partial(setting, kind="length")
area = partial(setting, kind="area")
flag = partial(setting, kind="flag")
whole = partial(setting, kind="int")
classes = partial(setting, kind="classes")
file = partial(setting, kind="file")
files = partial(setting, kind="files")


@dataclass(frozen=True)
class RunConfig:
    """All settings of a run. ``None`` is the default of the help: often tiler decides from the data and reports it."""

    preset: str | None = setting(
        None,
        f"named settings to start from: {', '.join(preset_names())}. --config overrides them, and the command line "
        "overrides both; `tiler config --preset NAME` prints them",
        kind="preset",
    )
    method: str = setting(
        "auto", "ground filter (see `tiler methods`); `keep` uses the classes of the input"
    )
    parameters: tuple[tuple[str, str], ...] = setting(
        (),
        "parameters of the method, name=value (`tiler methods NAME` lists them)",
        kind="pairs",
    )
    ground_classes: tuple[int, ...] = classes(
        (2,), "classes of the input that are ground for `--method keep`"
    )
    products: tuple[str, ...] = setting(
        ("dtm",),
        f"rasters to write, each as OUT/<name>.tif: {PRODUCTS_HELP}. Vector products, each as OUT/<name>.gpkg: "
        "contours (lines), spots (tops and bottoms)",
        kind="names",
        choices=(*PRODUCTS, *VECTOR_PRODUCTS),
    )
    sheets: Sides | str | None = setting(
        None,
        "side of the sheets into which each product is cut, or width x height (1000x1250), or FILE with a polygon for "
        "each sheet, in any CRS. The sheets are OUT/<product>/<sheet-name>.tif, with a VRT OUT/<product>.vrt over "
        "them, and are listed in OUT/sheets.gpkg; those of contours and spots end with .gpkg; default: one file",
        unit="m",
        kind="sheets",
    )
    sheet_field: str | None = setting(
        None,
        "field with the names of the sheets in the file given by --sheets; needed with a file",
    )
    sheet_name: str | None = setting(
        None,
        "file name of a sheet without its suffix. Fields are name (product), x and y (west and south edge), east and "
        "north in units of the CRS, x_km, y_km, east_km, north_km in thousands of units, and sheet (value of "
        f"sheet-field). A field may have a format: {{x_km:04.0f}}; default: {DEFAULT}, or {DRAWN} for sheets of a file",
        kind="template",
    )
    product_name: str | None = setting(
        None,
        "other names of the files of rasters: dtm=MNT,dsm=MNS writes OUT/MNT.tif and OUT/MNS.tif. With --sheets, names "
        "of sheets have them (field name of sheet-name), but folders and VRTs keep the names of the products",
        kind="product_names",
    )
    empty_sheets: bool = flag(False, "also write sheets that contain points but no heights")
    resolution: Fraction | tuple[Fraction, ...] | None = setting(
        None,
        "pixel size; default: 1 m (2 ft), or the point spacing if it is larger. Photogrammetric clouds get 0.1, "
        "0.25 or 0.5 m if such a pixel holds about ten points. In feet: 0.1, 0.2, 0.5, 1, 2, 5 or 10 ft. With several "
        f"(0.5,2; at most {MAX_RESOLUTIONS}), each has a folder: OUT/0.5m, OUT/2m",
        unit="m",
        kind="lengths",
    )
    tile_size: Fraction | None = length(
        None, "side of a filter tile; default: from density and memory"
    )
    halo: Fraction | None = length(
        None,
        "width of the margin around a tile that the filter reads; default: from the method",
    )
    max_edge: Fraction = length(
        Fraction(100),
        "longest edge and largest circumradius of a TIN facet that fills pixels; others stay nodata",
    )
    interpolation: str = setting(
        "linear",
        "heights between ground points: linear on the TIN, natural neighbours, or idw (12 nearest, 1 / squared "
        "distance). All of them fill the same pixels",
        choices=("linear", "natural", "idw"),
    )
    surface: str | None = setting(
        None,
        "ground points used for the DTM: all, or the one at the median or a percentile (p10) of the heights in each "
        "cell of half a pixel; default: all, or the median for photogrammetric clouds",
        kind="surface",
    )
    erode: Fraction | None = length(
        None,
        "leave out ground points nearer than this to an object at least 1 m higher, such as stumps of walls; "
        "default: 0, or 0.5 m for photogrammetric clouds",
    )
    voids: str = setting(
        "leave",
        "holes inside the survey, wider than `max-edge` in the DTM, without returns in the DSM: leave (no heights), "
        "fill (from their boundary), or mark (fill, and write the mask)",
        choices=("leave", "fill", "mark"),
    )
    canopy: str = setting(
        FILL_CANOPY,
        "terrain where a closed canopy hides the ground of a photogrammetric cloud: fill (from the ground around it, "
        "farther in from the height of its crowns, value 6 of the mask) or void (no heights)",
        choices=(FILL_CANOPY, VOID_CANOPY),
    )
    breaklines: tuple[str, ...] = files(
        (),
        "file of lines that the terrain follows, in any CRS, in 3D or with a height in a column (z, elevation). "
        "Ground points within half a pixel of a line are left out",
    )
    edits: str | None = file(
        None,
        "file of polygons, in any CRS, with a column `action`. With not_ground, no point inside is ground. With "
        "ground, the ground points of the input are ground, or the lowest point of each pixel if there are none. With "
        "void, the terrain has no height. With flat, it has the height in the column z. In OUT/review.gpkg, "
        "fixed places are edits; default: none",
    )
    water: str = file(
        AUTO_WATER,
        "water bodies: none, auto (found in the data) or FILE. Lakes become level, and rivers fall along their flow. "
        "FILE has polygons in any CRS with optional columns kind (lake, river) and level, and optional lines of flow",
    )
    water_low: str = setting(
        LOW_AS_NOISE,
        "class of returns more than 0.5 m below the water level in the classified clouds: noise (7), or keep (as other "
        "points in water)",
        choices=(LOW_AS_NOISE, KEEP_LOW),
    )
    water_min_lake: Fraction = area(
        Fraction(8000), "smallest lake or pond that `--water auto` finds (8000, 0.8ha, 2acre)"
    )
    water_min_river_width: Fraction = length(
        Fraction(15), "smallest mean width of a river or canal that `--water auto` finds"
    )
    water_min_island: Fraction = area(
        Fraction(1000),
        "smallest island that `--water auto` keeps; smaller islands become water",
    )
    bridges: str = setting(
        "keep",
        "bridge decks in the terrain: keep, or remove (class 17, listed in OUT/bridges.gpkg). A deck has ground 2 m "
        "lower next to both edges, and a road at both ends",
        choices=("keep", "remove"),
    )
    contour_interval: Fraction | None = length(
        None,
        "height difference between contours; default: a round number in the unit of the CRS, at least four times the "
        "noise of the ground and 0.25 m (1 ft), with at most 50 levels",
    )
    contour_smooth: Fraction | None = length(
        None,
        "standard deviation of the Gaussian that smooths the heights for contours (0 for no smoothing); default: 2 "
        "pixels",
    )
    classified: str = setting(
        "laz",
        "format of the classified clouds in OUT/classified: laz, las (larger, faster to read), copc (points ordered "
        "by position, for fast drawing and reading of parts) or none",
        choices=("laz", "las", "copc", "none"),
    )
    outline: str = setting(
        "survey",
        "border of the heights: survey (positions with points, and gaps of up to 20 m between them, more if points "
        "are sparse) or hull (of facets up to `max-edge`)",
        choices=("survey", "hull"),
    )
    spike: Fraction = length(
        Fraction(5),
        "leave a pixel's highest return out of the DSM if it is at least this much higher than all returns in the "
        "neighbouring pixels (at least within 1 m)",
    )
    memory: int | None = setting(
        None,
        "memory limit of a worker; default: half of the memory of the machine or container, divided by the workers, at "
        "most 4 GiB",
        kind="bytes",
    )
    workers: int | None = whole(
        None,
        "number of worker processes, with one thread each; default: the cores that tiler may use, fewer if a worker "
        "would have less than 512 MiB",
    )
    in_process: bool = flag(
        False,
        "run all work in the process of the command, for debugging; a crash then ends the run",
    )
    task_seconds: int = whole(
        600,
        "time limit of a task of up to a million points, proportionally longer for larger tasks. A worker that exceeds "
        "it counts as hung and is replaced",
        unit="s",
    )
    scheduler: str | None = setting(
        None,
        "address of a running Dask scheduler (tcp://host:8786); default: workers on this machine",
    )
    store: str | None = setting(None, "path or URL of the tile store; default: OUT/store.zarr")
    crs: str | None = setting(
        None,
        "CRS of files that have none (EPSG:..., WKT), or `none` if it is unknown (metres assumed). A compound CRS like "
        "EPSG:2154+5720 also adds its vertical datum to files with only EPSG:2154; default: a file without CRS is an "
        "error",
        kind="crs",
    )
    units: str | None = setting(
        None, "units of the coordinates, h or h,v (m, ft, usft); default: the units of the CRS"
    )
    bounds: tuple[float, float, float, float] | None = setting(
        None,
        "process only X0 Y0 X1 Y1 in CRS units; the necessary margin is read as well; default: everything",
        kind="bounds",
    )
    aoi: str | None = file(
        None,
        "process only the polygons of a GeoPackage, GeoJSON or Shapefile, in any CRS; the necessary margin is read as "
        "well; default: everything",
    )
    keep_classes: tuple[int, ...] = classes(
        (7, 9, 17, 18),
        "classes that are not filtered and never overwritten, or `none` to ignore the classes of the input, for a fair "
        "test on a cloud with reference classes",
    )
    reclass: str = setting(
        ONLY_GROUND,
        "classes that change in the classified clouds: ground, or all. With ground, ground points get 2 and low noise "
        "7. Points that were ground in the input get 1, or 9 in water, or 17 on a removed bridge. All other classes "
        "stay. With all, every filtered point gets 2, 7, 17 or 1",
        choices=(ONLY_GROUND, ALL),
    )
    returns: str | None = setting(
        None,
        "returns that are filtered and gridded: first, last, or numbers (1, 2-4); default: all. With this option and "
        "the next four options, the classified clouds still contain all points",
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
    drop_classes: tuple[int, ...] = classes(
        (), "classes of the input that are neither filtered nor gridded"
    )
    withheld: str = setting(
        DROP_WITHHELD,
        "points flagged as withheld: drop (they are neither filtered nor gridded), or keep (as other points)",
        choices=(DROP_WITHHELD, KEEP_WITHHELD),
    )
    priority: str | None = file(
        None,
        "which of several surveys of one place counts there: newest, or FILE with a line per survey, the first line "
        "counts most. A line has patterns of files or folders, separated by semicolons. Elsewhere the other surveys "
        "count; default: all points count",
    )
    skip_synthetic: bool = flag(
        False, "do not filter points flagged as synthetic; they keep their class"
    )
    skip_overlap: bool = flag(
        False, "do not filter points flagged as overlap; they keep their class"
    )
    sigma: Fraction | None = length(
        None,
        "standard deviation of the height noise, for methods that need it; default: estimated from planar patches",
    )
    kind: str | None = setting(
        None,
        "source of the cloud: laser scanning (als) or dense image matching (dim); default: decided from the data",
        choices=("als", "dim"),
    )
    statistics: str | None = setting(
        None,
        "OUT folder of an earlier run with the same method, from which kind, density, noise and height of trees are "
        "used; default: measure them in this run",
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
        "reaction to a broken file or tile: skip it (exit code 5), or stop the run",
        choices=("skip", "stop"),
    )
    salvage: bool = flag(
        False, "read the intact part of a truncated file instead of leaving the file out"
    )
    verify: bool = flag(
        False, "read all inputs and outputs again to check whether they changed"
    )
    overwrite: bool = flag(False, "start from the beginning instead of resuming the run in OUT")
    force: bool = flag(False, "replace files in OUT that no run of this OUT wrote")
    clean_store: bool = flag(False, "remove the store when the run is done")

    @property
    def pixel(self) -> Fraction | None:
        """Setting `resolution`, or the finest of several."""
        if isinstance(self.resolution, tuple):
            return self.resolution[0]
        return self.resolution

    @property
    def surface_percent(self) -> int | None:
        """Percentile of the heights in a cell that is used for the DTM, or None for all points."""
        if self.surface is None or self.surface == "all":
            return None
        if self.surface == "median":
            return 50
        return int(self.surface[1:])

    @property
    def erosion(self) -> Fraction:
        """Setting `erode`, or 0 if it is not given."""
        return Fraction(0) if self.erode is None else self.erode

    @property
    def water_file(self) -> str | None:
        """File of the setting `water`, or None if the setting has another value."""
        return None if self.water in (NO_WATER, AUTO_WATER) else self.water

    @property
    def priority_file(self) -> str | None:
        """File of the setting `priority`, or None if the setting has another value."""
        return None if (self.priority or "").lower() == NEWEST else self.priority

    @property
    def sheet_file(self) -> str | None:
        """File of the setting `sheets`, or None if the setting has another value."""
        return self.sheets if isinstance(self.sheets, str) else None

    @property
    def sheet_template(self) -> str:
        """Setting `sheet_name`, or its default for the kind of the sheets."""
        return self.sheet_name or (DEFAULT if self.sheet_file is None else DRAWN)

    @property
    def source_kind(self) -> str | None:
        """Setting `kind`, with the name that methods use (`ptd.passes.RunHints`)."""
        return "lidar" if self.kind == "als" else self.kind

    @property
    def kind_option(self) -> str:
        """Option that gives the kind: ``--kind als``, or a preset with this kind, such as ``--preset city``."""
        if self.preset is not None and load_preset(self.preset).get("kind") == self.kind:
            return f"--preset {self.preset}"
        return f"--kind {self.kind}"

    @property
    def exported(self) -> tuple[str, ...]:
        """Products that are written as rasters."""
        marked = {"mask"} if self.voids == "mark" else set()
        return tuple(name for name in PRODUCTS if name in marked or name in self.products)

    @property
    def drawn(self) -> tuple[str, ...]:
        """Products that are written as vector files."""
        return tuple(name for name in VECTOR_PRODUCTS if name in self.products)

    @property
    def cut(self) -> tuple[str, ...]:
        """Products that have a file for each sheet, if the run has sheets."""
        return (*self.exported, *self.drawn)

    @property
    def selection(self) -> Selection:
        """Selection of the points that are filtered and gridded."""
        return Selection(
            self.returns,
            self.scan_angle,
            self.source_id,
            self.drop_classes,
            self.withheld == KEEP_WITHHELD,
        )

    def to_json(self) -> dict[str, Any]:
        """Return the settings as JSON-able values, which `from_mapping` reads."""
        return {f.name: plain_value(getattr(self, f.name)) for f in fields(self)}

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any]) -> RunConfig:
        """Parse settings from plain values (TOML, JSON, options), or raise ConfigError.

        If there is a ``preset``, settings that are not given come from it.
        """
        return cls(**cls.parse(over_preset(data)))

    @classmethod
    def parse(cls, data: Mapping[str, Any]) -> dict[str, Any]:
        """Return plain values of some settings as parsed values, or raise ConfigError."""
        known = {f.name: f for f in fields(cls)}
        for name in data:
            if name not in known:
                raise ConfigError(
                    f"unknown setting {name!r}; use the names of `tiler config --template`"
                )
        return {name: parse_value(known[name], value) for name, value in data.items()}

    def updated(self, **changes: Any) -> RunConfig:
        """Return a copy in which these fields (already parsed) are replaced."""
        return dataclasses.replace(self, **changes)
