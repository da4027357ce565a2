"""Models that are cut at the outline of the survey, with level water."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tiler.core.products import BEYOND, SURVEYED, VOID
from tiler.core.raster import NODATA
from tiler.grid.block_surroundings import EditsNear, WatersNear
from tiler.grid.canopy import OPEN
from tiler.grid.holes import hole_cells, holes_of_block
from tiler.grid.steps import Counts

Bools = npt.NDArray[np.bool_]
Float64 = npt.NDArray[np.float64]


def outline(
    heights: Float64,
    survey: npt.NDArray[np.float32],
    area: Bools,
    edits: EditsNear,
    waters: WatersNear | None = None,
    canopy: Float64 | None = None,
    below: Float64 | None = None,
    *,
    cut: bool,
    finds_water: bool,
) -> tuple[npt.NDArray[np.float32], Counts]:
    """Return a model that ends at the outline of the survey, with level water.

    Facets span a concave border of the survey, so land
    that was never surveyed would get a height from the border. Facets also span rivers that
    leave the survey. Water keeps its height there.

    Parameters
    ----------
    heights : float64 (height, width)
    survey : float32 (height + 2, width + 2)
    area : bool (height + 2, width + 2)
        Pixels in the area of the run. Holes outside it do not count.
    edits : EditsNear
        They are applied after water and canopy.
    waters : WatersNear, optional
    canopy : float64 (height, width), optional
        Canopy. Where it hides the ground, pixels get no height.
    below : float64 (height, width), optional
        Heights below a canopy, which replace those of the model, NaN where the model stays as it is.
    cut : bool
        Whether heights beyond the survey are removed.
    finds_water : bool
        Whether the run found the water itself. Drawn water gets no height outside the survey where the model has none.

    Returns
    -------
    heights : float32 (height, width)
    counts : dict
        ``cut``: number of pixels that lost their height other than to a canopy. ``water``: key of the area of each body
        of water, and the number of its pixels. ``bare``: cells with pixels in places without returns that have a height
        and are not in water (`hole_cells`). ``surveyed``, ``voided``, ``holes``, ``edit_holes``: see `holes_of_block`.
    """
    nodata = np.float32(NODATA)
    had = ~np.isnan(heights)
    before = np.where(had, heights, nodata).astype(np.float32)
    values = before.copy()
    if canopy is not None:
        values[canopy > OPEN] = nodata
    if below is not None:
        values = np.where(np.isnan(below), values, below).astype(np.float32)
    if not np.array_equal(values, before):
        edits.set_heights(values)
    hidden = int(np.count_nonzero(had & (values == nodata)))
    beyond, bare = survey[1:-1, 1:-1] == BEYOND, survey[1:-1, 1:-1] >= VOID
    water: list[tuple[str, int]] = []
    if waters is not None and waters.waters is not None:
        wet = waters.inside
        water = waters.set_heights(values, had | ~beyond | finds_water)
        edits.set_heights(values)
        beyond &= ~wet
        bare &= ~wet
    if cut:
        values[beyond] = nodata
    known = values != nodata
    holes = holes_of_block(known, survey >= SURVEYED, edits, area)
    return values, {
        "cut": max(int(np.count_nonzero(had & ~known)) - hidden, 0),
        "water": water,
        "bare": hole_cells(bare & known & area[1:-1, 1:-1], edits.block, survey < SURVEYED),
        **holes,
    }
