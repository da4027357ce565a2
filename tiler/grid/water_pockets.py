"""Pockets of low terrain beside a body of water, which the shore between its coarse cells leaves out.

A coarse cell with masonry or a steep bank counts as land, but its pixels next to the water may be water. Terrain there
that lies below the level and is closed off by higher terrain is water. Low terrain that is not closed off within a few
pixels stays terrain, and the run warns of it.
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
"""Distance in pixels from the water within which terrain must close off a pocket."""

OVERLAP = 0.9
"""Half of the side of a pixel's polygon, in pixels.

Polygons of more than a pixel leave no gap to the shore, which lies anywhere between two centres of pixels.
"""


class Beside(NamedTuple):
    """Pixels with a height within `POCKET_PIXELS` of a body of water.

    Attributes
    ----------
    xyz : int64 (3, n)
        Centres and heights in absolute counts.
    places : int64 (2, n)
        Rows and columns of the raster.
    distance : int64 (n,)
        Steps to the water, also diagonal ones, from 1.
    """

    xyz: Counts
    places: Counts
    distance: Counts


def pockets(body: Water, beside: Beside, noise: float) -> npt.NDArray[np.bool_]:
    """Return the mask of the pixels in pockets, bool (n,).

    Parameters
    ----------
    body : Water
        Body with its level.
    beside : Beside
    noise : float
        Depth in counts below the level that the deepest pixel of a pocket must exceed.
    """
    x, y, z = beside.xyz
    depth = body.heights(x, y) - z
    low = np.flatnonzero(depth > 0)
    is_pocket = np.zeros(len(x), np.bool_)
    if not len(low):
        return is_pocket
    pairs = scipy.spatial.cKDTree(beside.places[:, low].T).query_pairs(1, p=np.inf, output_type="ndarray")
    links = scipy.sparse.coo_array((np.ones(len(pairs)), pairs.T), (len(low), len(low)))
    count, label = scipy.sparse.csgraph.connected_components(links, directed=False)
    distance = beside.distance[low]
    touches = np.bincount(label, distance == 1, count) > 0
    leaves = np.bincount(label, distance >= POCKET_PIXELS, count) > 0
    deep = np.bincount(label, depth[low] > noise, count) > 0
    is_pocket[low] = (touches & ~leaves & deep)[label]
    return is_pocket


def with_pixels(body: Water, centres: Counts, pixel: float) -> Water:
    """Return the body with the pixels of these centres, int64 (2, n); ``pixel`` is their side in counts."""
    import shapely

    x, y = centres
    half_side = OVERLAP * pixel
    joined = shapely.box(x - half_side, y - half_side, x + half_side, y + half_side)
    return replace(body, area=area_of(shapely.union_all([polygon_of(body.area), *joined])))
