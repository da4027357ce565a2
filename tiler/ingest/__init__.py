"""Ingest of the points of source files into the store, in two steps shared by all workers.

`spool_piece` decodes a piece of a file, converts it to the frame, sorts it by bucket and spools it. `assemble_buckets`
collects the points of a bucket, finds duplicates and puts the candidates first.
"""

from tiler.ingest.assemble import BucketParts, assemble_buckets
from tiler.ingest.spool import OUTSIDE_AREA, SpoolPiece, spool_piece
from tiler.ingest.strays import Strays, far_buckets

__all__ = [
    "OUTSIDE_AREA",
    "BucketParts",
    "SpoolPiece",
    "Strays",
    "assemble_buckets",
    "far_buckets",
    "spool_piece",
]
