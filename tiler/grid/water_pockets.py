"""Search for pockets: low terrain next to a body of water that is water as well.

The shore follows coarse cells. A cell with masonry or a steep bank counts as land, but its
pixels next to the water may be water. Such a pixel is water if it lies below the level and
higher terrain closes off the pocket around it. Low terrain that is not closed off within a few
pixels stays terrain, and the run warns about it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from tiler.core.water import Counts, Water
from tiler.grid.centreline import area_of, polygon_of

POCKET_PIXELS = 6
"""A pocket has to be closed off by terrain within this distance from the water, in pixels."""

OVERLAP = 0.9
"""Half the side of the square that is added to the water for a pixel, in pixels.

The squares are larger than the pixels, because the shore may lie anywhere between the centres
of two pixels.
"""


class Beside(NamedTuple):
    """Pixels within `POCKET_PIXELS` of a body of water that have a height.

    Attributes
    ----------
    xyz : int64 (3, n)
        Centres and heights in absolute counts.
    pixels : int64 (2, n)
        Rows and columns in the raster.
    distance : int64 (n,)
        Number of straight or diagonal steps to the water, at least 1.
    """

    xyz: Counts
    pixels: Counts
    distance: Counts


def pockets(body: Water, beside: Beside, noise: float) -> npt.NDArray[np.bool_]:
    """Return the mask of the pixels in pockets, bool (n,).

    Parameters
    ----------
    body : Water
        Body with its level.
    beside : Beside
    noise : float
        The deepest pixel of a pocket is deeper than this below the level, in counts.
    """
    x, y, z = beside.xyz
    depth = body.heights(x, y) - z
    low = np.flatnonzero(depth > 0)
    is_pocket = np.zeros(len(x), np.bool_)
    if not len(low):
        return is_pocket
    pairs = scipy.spatial.cKDTree(beside.pixels[:, low].T).query_pairs(
        1, p=np.inf, output_type="ndarray"
    )
    links = scipy.sparse.coo_array((np.ones(len(pairs)), pairs.T), (len(low), len(low)))
    count, label = scipy.sparse.csgraph.connected_components(links, directed=False)
    distance = beside.distance[low]
    is_at_water = np.bincount(label, distance == 1, count) > 0
    is_open = np.bincount(label, distance >= POCKET_PIXELS, count) > 0
    is_deep = np.bincount(label, depth[low] > noise, count) > 0
    is_pocket[low] = (is_at_water & ~is_open & is_deep)[label]
    return is_pocket


def with_pixels(body: Water, centres: Counts, pixel: float) -> Water:
    """Return a body with additional pixels. ``centres`` (2, n) and the side ``pixel`` of a pixel are in counts."""
    import shapely

    x, y = centres
    half_side = OVERLAP * pixel
    joined = shapely.box(x - half_side, y - half_side, x + half_side, y + half_side)
    return replace(body, area=area_of(shapely.union_all([polygon_of(body.area), *joined])))
