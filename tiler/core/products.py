"""Products of a run, with the content of each raster and its description in the file, and the meaning of its values.

This is the only list of the products.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from tiler.errors import ConfigError

OUTSIDE, MEASURED, INTERPOLATED, FILLED, HOLE, WATER, CANOPY = range(7)
"""Values of the product ``mask``."""

MASK_VALUES = {
    OUTSIDE: "outside the survey",
    MEASURED: "measured: a ground point lies in the pixel",
    INTERPOLATED: "interpolated within the limit",
    FILLED: "filled beyond the limit",
    HOLE: "hole: no height inside the survey, or a tile that failed",
    WATER: "water: level, or falling along its flow",
    CANOPY: "canopy, bridged: crowns hide the ground",
}


NODATA = -9999.0
"""Nodata value of rasters in the store, and the default of files."""
OUTLINED = "dtm-outlined"
"""Raster of the store that is the delivered terrain."""

MAX_RESOLUTIONS = 4
"""Maximum number of resolutions of a run, which bounds the rasters that a store keeps."""

LOWEST_HEIGHT = -2000.0
"""Lowest value that could be a height, in metres or feet."""
MAX_HEIGHT = 100_000.0
"""Highest value that could be a height, in metres or feet."""


def parse_nodata(value: Any) -> float:
    """Return the nodata value, which may be NaN.

    Raise ConfigError if it is not a number, is not exact in float32, or could be a height.
    """
    try:
        number = float(value)
        if math.isnan(number):
            return number
        exact = struct.unpack("<f", struct.pack("<f", number))[0] == number
    except (TypeError, ValueError):
        raise ConfigError(
            f"nodata {value!r}: not a number; give a number like -9999 or -999999, or nan"
        ) from None
    except OverflowError:
        exact = False
    if not exact or not math.isfinite(number):
        raise ConfigError(
            f"nodata {value}: a float32 raster cannot hold it exactly; use -9999 or -999999"
        )
    if LOWEST_HEIGHT < number < MAX_HEIGHT:
        raise ConfigError(f"nodata {value}: could be a height; use -9999 or -999999")
    return number


CONTOURS, SPOTS = "contours", "spots"
VECTOR_PRODUCTS = (CONTOURS, SPOTS)
"""Vector products: GeoPackages of lines and of points."""

# A coarse cell of the survey (`tiler.grid.coverage`) has one of the next five values.
BEYOND = 0
"""Cell outside the survey."""
BORDER = 1
"""Cell in the outermost ring of the survey. The outline cuts it, so a pixel without a height
there is not a hole."""
SURVEYED = 2
VOID = 3
"""Cell inside the survey, in a gap without points that is wider than the gaps that are
bridged."""
BARE = 4
"""Cell inside the survey, in a gap without points that is bridged, but wider than four times the spacing of the points
around it."""

MODELS = ("dtm", "dsm")
"""Products whose voids can be filled."""

HEIGHT = "height"
"""Value of `Product.unit` for bands in the vertical unit of the CRS."""


@dataclass(frozen=True)
class Read:
    """What a step reads for a block of a raster (`tiler.grid.steps`).

    Attributes
    ----------
    of : str
        Kind of what is read, and after a colon the name of a raster.
    margin : int
        Width of what is read around the block: in pixels of a raster, in counts of points.
    """

    of: str
    margin: int = 0

    @property
    def kind(self) -> str:
        """Key of `tiler.grid.steps.READERS`."""
        return self.of.partition(":")[0]

    @property
    def raster(self) -> str:
        """Name of the raster, or empty text."""
        return self.of.partition(":")[2]


@dataclass(frozen=True)
class Product:
    """Raster that a run writes for the user.

    Attributes
    ----------
    description : str
        Description of the band.
    unit : str
        Unit of the band as GDAL names it, `HEIGHT`, or empty if it has no unit.
    dtype : str
        ``float32`` or ``uint8``.
    nodata : float or None
        Value of pixels without a value, or None if every pixel has a value.
    resampling : str
        Resampling of the overviews, as GDAL's COG driver names it.
    predictor : str
        Predictor of the compression, as GDAL's COG driver names it.
    colours : mapping of int to (red, green, blue)
        Colour table, empty if there is none.
    values : mapping of int to str
        Meaning of each value, if the values are classes.
    help : str
        What the name does not say, for the help of ``--products``.
    reads : mapping of str to Read
        Arguments of the function of the product, which has its name and is in `tiler.grid.derived`. They are read as
        `tiler.grid.steps.READERS` has them, but ``delivered:<product>`` is the raster that the file of a product has.
        At least one of them is a product or points. Empty for products with a row of their own in
        `tiler.grid.tasks.raster_table`.
    """

    description: str
    unit: str = HEIGHT
    dtype: str = "float32"
    nodata: float | None = NODATA
    resampling: str = "AVERAGE"
    predictor: str = "FLOATING_POINT"
    colours: Mapping[int, tuple[int, int, int]] = field(default_factory=dict)
    values: Mapping[int, str] = field(default_factory=dict)
    help: str = ""
    reads: Mapping[str, Read] = field(default_factory=dict)

    @property
    def categories(self) -> tuple[str, ...]:
        """Names of the values 0, 1, 2 ..., if the values are classes."""
        return tuple(
            self.values.get(value, "") for value in range(max(self.values, default=-1) + 1)
        )


PRODUCTS: dict[str, Product] = {
    "dtm": Product("terrain height"),
    "dsm": Product("surface height: highest return", help="surface"),
    "ndsm": Product(
        "height of the surface above the terrain",
        help="surface above the terrain",
        reads={"surface": Read("delivered:dsm"), "terrain": Read("delivered:dtm")},
    ),
    "hillshade": Product(
        "multidirectional hillshade",
        "",
        "uint8",
        0,
        predictor="STANDARD",
        reads={"terrain": Read("delivered:dtm", 1), "place": Read("place")},
    ),
    "slope": Product(
        "slope",
        "degree",
        help="degrees",
        reads={"terrain": Read("delivered:dtm", 1), "place": Read("place")},
    ),
    "density": Product(
        "ground points per square metre",
        "1/m2",
        nodata=None,
        help="ground points per m2",
        reads={"points": Read("points"), "place": Read("place")},
    ),
    "distance": Product(
        "distance to the nearest ground point",
        "metre",
        nodata=None,
        help="to the nearest ground point, m",
    ),
    "sigma": Product(
        "standard error of the terrain height",
        help="standard error of the heights, in their unit",
    ),
    "mask": Product(
        "where the terrain height comes from",
        unit="",
        dtype="uint8",
        nodata=OUTSIDE,
        resampling="NEAREST",
        predictor="NO",
        colours={
            OUTSIDE: (255, 255, 255),
            MEASURED: (90, 150, 90),
            INTERPOLATED: (190, 210, 150),
            FILLED: (230, 150, 60),
            HOLE: (150, 30, 50),
            WATER: (70, 130, 200),
            CANOPY: (30, 90, 70),
        },
        values=MASK_VALUES,
        help="source of each height",
    ),
}
"""Products by name, in the order of the help and of lists."""
PRODUCTS_HELP = ", ".join(
    f"{name} ({product.help})" if product.help else name for name, product in PRODUCTS.items()
)
"""Names of all products for the help, with what the names do not say."""


OPEN, COVERED, WET = "open", "covered", "water"
GROUPS = (OPEN, COVERED, WET)
"""Groups of ground for the standard error in run.json and the report."""
COVERED_SHARE = 0.5
"""Minimum share of objects among the points around covered ground. Filled pixels and canopy are
covered, too."""
EDGES_M = (0.0, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0)
"""Edges of the classes of the standard error, in metres."""
