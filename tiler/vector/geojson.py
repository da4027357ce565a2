"""GeoJSON (RFC 7946)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tiler.errors import InputError

OWN_CRS = "EPSG:4326"
"""Where a file does not name another."""


def read_features(path: Path, wanted: str) -> tuple[list[dict[str, Any]], str]:
    """The features of a file and their CRS; raises InputError, which says to write ``wanted`` as features."""
    try:
        content = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not valid GeoJSON ({error})") from error
    if not isinstance(content, dict) or content.get("type") != "FeatureCollection":
        raise InputError(f"{path}: no GeoJSON FeatureCollection; write {wanted} as features")
    features = content.get("features") or []
    if not isinstance(features, list) or not all(isinstance(f, dict) for f in features):
        raise InputError(f"{path}: its features are no objects; write {wanted} as features")
    # Before RFC 7946 a member named the CRS, which is still what most programs write.
    crs = content.get("crs")
    named = (crs.get("properties") or {}).get("name") if isinstance(crs, dict) else None
    return features, str(named) if named else OWN_CRS
