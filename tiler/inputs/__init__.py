"""Inputs: which files a run gets, what their headers and a sample of their points say, and the CRS that they share.

The plan uses `find_inputs`, `inspect` (in parallel for several files) and `agree`; ingest divides files into `pieces`.
"""

from tiler.inputs.common_crs import Agreement, agree
from tiler.inputs.extent import FAR
from tiler.inputs.georeference import Georeference, describe
from tiler.inputs.lists import read_list
from tiler.inputs.patches import Patch
from tiler.inputs.point_tiles import PointTiles, Touches, is_point_tiles, key_of, read_point_tiles
from tiler.inputs.requantise import bounds_in_counts
from tiler.inputs.search import find_inputs, is_list
from tiler.inputs.sources import (
    SourceInfo,
    claimed_bounds,
    inspect,
    inspect_guarded,
    pieces,
    read_guarded,
    window_pieces,
)

__all__ = [
    "FAR",
    "Agreement",
    "Georeference",
    "Patch",
    "PointTiles",
    "SourceInfo",
    "Touches",
    "agree",
    "bounds_in_counts",
    "claimed_bounds",
    "describe",
    "find_inputs",
    "inspect",
    "inspect_guarded",
    "is_list",
    "is_point_tiles",
    "key_of",
    "pieces",
    "read_guarded",
    "read_list",
    "read_point_tiles",
    "window_pieces",
]
