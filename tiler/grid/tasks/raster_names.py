"""Names of the rasters of the store, and the values of their pixels without one."""

from __future__ import annotations

from tiler.config import RunConfig
from tiler.core.products import PRODUCTS

MODELS = ("dtm", "dsm")
"""Products whose voids can be filled."""
ABOVE = "dtm-above"
"""Step without pixels that counts where the terrain lies above all returns."""
CANOPY, BELOW_CANOPY = "canopy", "canopy-below"
"""Rasters of a canopy that hides the ground, and of the terrain below it."""
CANOPY_CELLS, CANOPY_TERRAIN = "canopy-cells", "canopy-terrain"
"""Rasters of cells of canopies: the canopy, and the interpolated terrain around it."""


def final_raster(product: str, config: RunConfig) -> str:
    """Return the name of the raster that is delivered as a product."""
    if product in outlined_models(config):
        return f"{product}-outlined"
    return filled_raster(product, config)


def outlined_models(config: RunConfig) -> tuple[str, ...]:
    """Return the models from which a raster ``<name>-outlined`` is made.

    With ``--outline survey``, all models end at the outline of the survey. Otherwise only the
    terrain needs this raster, for level water and for canopies.
    """
    return MODELS if config.outline == "survey" else ("dtm",)


def filled_raster(product: str, config: RunConfig) -> str:
    """Return the name of the raster of a product with filled voids, or of the product if no voids are filled."""
    return f"{product}-filled" if product in MODELS and config.voids != "leave" else product


def nodata_of(product: str) -> float:
    """Return the nodata value of a product, or 0 if all pixels of the product have a value."""
    nodata = PRODUCTS[product].nodata
    return 0.0 if nodata is None else nodata
