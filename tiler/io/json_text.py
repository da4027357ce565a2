"""Reads JSON that other programs wrote."""

from __future__ import annotations

import json
from typing import Any


def read_object(text: str | bytes) -> dict[str, Any]:
    """The object in a JSON text; raises ValueError with the reason if there is none."""
    try:
        found = json.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deep") from error
    if not isinstance(found, dict):
        raise ValueError("holds no object")
    return found


def member(value: Any, name: str) -> dict[str, Any]:
    """The member ``name`` of an object if it is an object, too; otherwise an empty one."""
    found = value.get(name) if isinstance(value, dict) else None
    return found if isinstance(found, dict) else {}


def excerpt(value: Any, most: int = 40) -> str:
    """A value as an error shows it: printable, in one line, and at most ``most`` characters long."""
    if isinstance(value, int) and abs(value) >= 10**most:
        return "a number of many digits"
    text = repr(value)
    return text if len(text) <= most else f"{text[:most]}..."
