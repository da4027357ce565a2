"""The products of a run: what each raster holds, and how its file says so. The only place that lists them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from tiler.core.mask_values import FILLED, HOLE, INTERPOLATED, MASK_VALUES, MEASURED, OUTSIDE, WATER
from tiler.core.nodata import NODATA as NODATA

CONTOURS, SPOTS = "contours", "spots"
DRAWN = (CONTOURS, SPOTS)
"""Products that are no rasters: lines and points of a GeoPackage each."""

BEYOND, BORDER, SURVEYED, VOID = range(4)
"""Values of a coarse cell of the survey (`tiler.grid.survey`): outside; the survey's outermost ring of cells, which its
outline cuts, so that a pixel without a height there is no hole; inside; enclosed without points, wider than the gaps
that are bridged."""

HEIGHT = "height"
"""In place of a unit: the vertical unit of the CRS."""


@dataclass(frozen=True)
class Product:
    """One raster that people open.

    Attributes
    ----------
    description : str
        Of the band.
    unit : str
        Of the band as GDAL names it, `HEIGHT`, or empty for none.
    dtype : str
        ``float32`` or ``uint8``.
    nodata : float or None
        None: every pixel has a value.
    resampling : str
        Of the overviews, a name of GDAL's COG driver.
    predictor : str
        Of the compression, a name of GDAL's COG driver.
    colours : mapping of int to (red, green, blue)
        Colour table, empty for none.
    values : mapping of int to str
        What the values mean where they are classes.
    """

    description: str
    unit: str = HEIGHT
    dtype: str = "float32"
    nodata: float | None = NODATA
    resampling: str = "AVERAGE"
    predictor: str = "FLOATING_POINT"
    colours: Mapping[int, tuple[int, int, int]] = field(default_factory=dict)
    values: Mapping[int, str] = field(default_factory=dict)

    @property
    def categories(self) -> tuple[str, ...]:
        """Names of the values 0, 1, 2 ... where they are classes."""
        return tuple(self.values.get(value, "") for value in range(max(self.values, default=-1) + 1))


PRODUCTS: dict[str, Product] = {
    "dtm": Product("terrain height"),
    "dsm": Product("surface height: highest return"),
    "ndsm": Product("height of the surface above the terrain"),
    "hillshade": Product("multidirectional hillshade", "", "uint8", 0, predictor="STANDARD"),
    "slope": Product("slope", "degree"),
    "density": Product("ground points per square metre", "1/m2", nodata=None),
    "distance": Product("distance to the nearest ground point", "metre", nodata=None),
    "mask": Product(
        "where the terrain height comes from", "", "uint8", OUTSIDE, "NEAREST", "NO",
        {OUTSIDE: (255, 255, 255), MEASURED: (90, 150, 90), INTERPOLATED: (190, 210, 150), FILLED: (230, 150, 60),
         HOLE: (150, 30, 50), WATER: (70, 130, 200)}, MASK_VALUES,
    ),
}  # fmt: skip
"""In the order in which they are made."""
