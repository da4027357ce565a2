"""Ingest: source files to points in the store, in two steps that any number of workers share.

`spool_piece` decodes a piece of one file, puts it in the frame, sorts it by bucket and spools it;
`assemble_buckets` gathers the fragments of a bucket, finds duplicates and puts the candidates first.
Before them, for the plan: `find_inputs`, `inspect` (several files at a time), `agree`, `pieces`.
"""

from tiler.ingest.assemble import AssembleBuckets, BucketParts, assemble_buckets
from tiler.ingest.common_crs import Agreement, agree
from tiler.ingest.extent import FAR
from tiler.ingest.georeference import Georeference, describe
from tiler.ingest.patches import Patch
from tiler.ingest.point_tiles import PointTiles, Touches, is_point_tiles, read_point_tiles
from tiler.ingest.requantise import bounds_in_counts
from tiler.ingest.search import find_inputs, is_list
from tiler.ingest.sources import (
    SourceInfo,
    claimed_bounds,
    inspect,
    inspect_guarded,
    pieces,
    read_guarded,
    window_pieces,
)
from tiler.ingest.spool import OUTSIDE_AREA, SpoolPiece, spool_piece
from tiler.ingest.strays import Strays, find_strays

__all__ = [
    "FAR",
    "OUTSIDE_AREA",
    "Agreement",
    "AssembleBuckets",
    "BucketParts",
    "Georeference",
    "Patch",
    "PointTiles",
    "SourceInfo",
    "SpoolPiece",
    "Strays",
    "Touches",
    "agree",
    "assemble_buckets",
    "bounds_in_counts",
    "claimed_bounds",
    "describe",
    "find_inputs",
    "find_strays",
    "inspect",
    "inspect_guarded",
    "is_list",
    "is_point_tiles",
    "pieces",
    "read_guarded",
    "read_point_tiles",
    "spool_piece",
    "window_pieces",
]
