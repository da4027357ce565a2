"""Check that GDAL finds the database of PROJ, without which GeoTIFFs lose their CRS."""

from __future__ import annotations

import os

from tiler.errors import ConfigError

VARIABLES = ("PROJ_DATA", "PROJ_LIB")
"""Variables that name the folder of the database. Other GIS programs set them for themselves."""


def validate_proj_database() -> None:
    """Raise ConfigError if a variable names a folder without a database that fits the installed GDAL."""
    given = [f"{name}={os.environ[name]}" for name in VARIABLES if name in os.environ]
    if not given:
        return
    # This import takes a tenth of a second, and the variables are seldom set.
    import rasterio
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    try:
        with rasterio.Env():
            CRS.from_epsg(4326)
    except CRSError as error:
        raise ConfigError(
            f"{', '.join(given)}: GDAL finds no database of PROJ there that fits, and would write GeoTIFFs without "
            f"their CRS; unset {' and '.join(name.partition('=')[0] for name in given)} and try again"
        ) from error
