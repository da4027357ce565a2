"""Reads JSON of other people; whatever is no valid JSON object is a ValueError with the reason."""

from __future__ import annotations

import json
from typing import Any


def read_object(text: str | bytes) -> dict[str, Any]:
    """The object that a JSON text holds; raises ValueError, with the reason, where it holds none."""
    try:
        found = json.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deep") from error
    if not isinstance(found, dict):
        raise ValueError("holds no object")
    return found


def member(value: Any, name: str) -> dict[str, Any]:
    """The object under a name of an object; empty where either is none."""
    found = value.get(name) if isinstance(value, dict) else None
    return found if isinstance(found, dict) else {}


def excerpt(value: Any, most: int = 40) -> str:
    """A value as an error shows it: printable, on one line, and no longer than people read."""
    text = repr(value) if not isinstance(value, int) or abs(value) < 10**most else "a number of many digits"
    return text if len(text) <= most else f"{text[:most]}..."
