"""Inputs of a run: search for files, their headers, samples of their points, their common CRS.

The plan uses `find_inputs`, `inspect` (in parallel for several files) and `resolve_common_crs`.
The stage ingest divides files into `pieces`.
"""

from tiler.inputs.common_crs import CommonCrs, resolve_common_crs, validate_lengths
from tiler.inputs.extent import FAR, DensityPatch
from tiler.inputs.georeference import Georeference, describe
from tiler.inputs.lists import read_list
from tiler.inputs.point_tiles import EptDataset, is_ept, key_of, read_point_tiles
from tiler.inputs.requantise import bounds_in_counts
from tiler.inputs.search import find_inputs, is_list
from tiler.inputs.sources import (
    SourceInfo,
    header_bounds,
    inspect,
    inspect_in_child,
    pieces,
    read_in_child,
    window_pieces,
)

__all__ = [
    "FAR",
    "CommonCrs",
    "DensityPatch",
    "EptDataset",
    "Georeference",
    "SourceInfo",
    "bounds_in_counts",
    "describe",
    "find_inputs",
    "header_bounds",
    "inspect",
    "inspect_in_child",
    "is_ept",
    "is_list",
    "key_of",
    "pieces",
    "read_in_child",
    "read_list",
    "read_point_tiles",
    "resolve_common_crs",
    "validate_lengths",
    "window_pieces",
]
