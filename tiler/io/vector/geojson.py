"""GeoJSON (RFC 7946)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tiler.errors import InputError
from tiler.io.json_text import member, read_object

OWN_CRS = "EPSG:4326"
"""Where a file does not name another."""


def read_features(path: Path, wanted: str) -> tuple[list[dict[str, Any]], str]:
    """The features of a file and their CRS; raises InputError, which says to write ``wanted`` as features."""
    try:
        content = read_object(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not valid GeoJSON ({error}); write {wanted} as features") from error
    if content.get("type") != "FeatureCollection":
        raise InputError(f"{path}: no GeoJSON FeatureCollection; write {wanted} as features")
    features = content.get("features") or []
    if not isinstance(features, list) or not all(isinstance(f, dict) for f in features):
        raise InputError(f"{path}: its features are no objects; write {wanted} as features")
    # Before RFC 7946 a member named the CRS, which is still what most programs write.
    named = member(member(content, "crs"), "properties").get("name")
    return features, str(named) if named else OWN_CRS
