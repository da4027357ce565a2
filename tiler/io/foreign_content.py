"""Content of files of other programs: JSON, and signatures of packed files (zip, gzip), which no reader unpacks."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any


def parse_json_object(text: str | bytes, distinct_keys: bool = False) -> dict[str, Any]:
    """Return the object in a JSON text. Raise ValueError with the reason if the text is not a JSON object.

    With ``distinct_keys``, a repeated key in any object of the text raises ValueError. Otherwise its last value counts.
    """
    try:
        content = json.loads(text, object_pairs_hook=_distinct if distinct_keys else None)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
    if not isinstance(content, dict):
        raise ValueError("not a JSON object")
    return content


def _distinct(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    content: dict[str, Any] = {}
    for key, value in pairs:
        if key in content:
            raise ValueError(f"the key {excerpt(key)} is repeated")
        content[key] = value
    return content


def member(value: Any, name: str) -> dict[str, Any]:
    """Return the member ``name`` of an object if both are objects, otherwise an empty dict."""
    member_value = value.get(name) if isinstance(value, dict) else None
    return member_value if isinstance(member_value, dict) else {}


def excerpt(value: Any, most: int = 40) -> str:
    """Return a value as text for an error: printable, in one line, and shortened to ``most`` characters."""
    if isinstance(value, int) and abs(value) >= 10**most:
        return "a number of many digits"
    text = repr(value)
    return text if len(text) <= most else f"{text[:most]}..."


_SIGNATURES = {
    b"PK\x03\x04": "zip",
    b"\x1f\x8b": "gzip",
    b"\x28\xb5\x2f\xfd": "zstd",
    b"BZh": "bzip2",
    b"\xfd7zXZ": "xz",
    b"7z\xbc\xaf": "7-Zip",
    b"Rar!": "RAR",
}
"""Programs that pack files, by the first bytes of these."""


def packing_of(start: bytes) -> str | None:
    """Return the name of the program that packed a file that begins with ``start``, or None."""
    names = (name for signature, name in _SIGNATURES.items() if start.startswith(signature))
    return next(names, None)
