"""Products of a run, with the content of each raster and its description in the file.

This is the only list of the products.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from tiler.core.mask_values import (
    CANOPY,
    FILLED,
    HOLE,
    INTERPOLATED,
    MASK_VALUES,
    MEASURED,
    OUTSIDE,
    WATER,
)
from tiler.core.nodata import NODATA as NODATA

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
    reads : mapping of str to Read
        Arguments of the function of the product, which has its name and is in `tiler.grid.derived`. A raster
        ``delivered:<product>`` is another product. Empty for products with a row of their own in
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
    reads: Mapping[str, Read] = field(default_factory=dict)

    @property
    def categories(self) -> tuple[str, ...]:
        """Names of the values 0, 1, 2 ..., if the values are classes."""
        return tuple(
            self.values.get(value, "") for value in range(max(self.values, default=-1) + 1)
        )


PRODUCTS: dict[str, Product] = {
    "dtm": Product("terrain height"),
    "dsm": Product("surface height: highest return"),
    "ndsm": Product(
        "height of the surface above the terrain",
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
        "slope", "degree", reads={"terrain": Read("delivered:dtm", 1), "place": Read("place")}
    ),
    "density": Product(
        "ground points per square metre",
        "1/m2",
        nodata=None,
        reads={"points": Read("points"), "place": Read("place")},
    ),
    "distance": Product("distance to the nearest ground point", "metre", nodata=None),
    "sigma": Product("standard error of the terrain height"),
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
    ),
}
"""Products by name, in the order in which they are made."""
