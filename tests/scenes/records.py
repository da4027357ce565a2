"""Records of the ingest for tests of later stages."""

from __future__ import annotations

from typing import Any

from tiler.core.records import BucketRecord, SpoolRecord, TileRecord


def bucket_record(**values: Any) -> BucketRecord:
    """A bucket without points, but for the given values."""
    nothing: dict[str, Any] = {
        "cell": [0, 0], "n": 0, "n_candidates": 0, "n_participating": 0, "n_measured": 0,
        "duplicates": {"within": 0, "between": 0}, "z_participating": None,
        "classes": {}, "strays": [], "bounds": None, "z": None,
    }  # fmt: skip
    return BucketRecord(**{**nothing, **values})


def spool_record(**values: Any) -> SpoolRecord:
    """A piece without points, but for the given values."""
    nothing: dict[str, Any] = {
        "read": 0, "stored": 0, "outside": 0, "dropped": {}, "unselected": {}, "largest_rounding": 0.0, "buckets": [],
        "left": [], "identity": "", "fetched": 0, "bounds": None, "z": None,
    }  # fmt: skip
    return SpoolRecord(**{**nothing, **values})


def tile_record(**values: Any) -> TileRecord:
    """A record of a tile; values that do not matter are 0 or empty."""
    numbers = dict.fromkeys(
        ("points", "ground", "low_noise", "unclassified", "kept", "marked", "tries", "halo"), 0
    )
    areas = dict.fromkeys(("window_points", "core_area", "window_area"), 0)
    others: dict[str, Any] = {"cells": [], "labels": "", "partial": {}, "stats": {}}
    return TileRecord(**{**numbers, **areas, **others, **values})
