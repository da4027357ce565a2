"""Digests of values, arrays and bytes, which decide what a run has to do again."""

from __future__ import annotations

import hashlib
import json
from dataclasses import fields, is_dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from tiler.redaction import stored

if TYPE_CHECKING:  # Modules that start before numpy is loaded import this one.
    import numpy.typing as npt

NOT_IN_DIGEST = {"digest": False}
"""Metadata of an argument of a task that affects how the task runs, but not its result."""


def digest_of(*parts: Any) -> str:
    """Return a short stable digest of JSON-able values and dataclasses, without fields that are `NOT_IN_DIGEST`.

    The digest does not depend on the order of keys, or on passwords and tokens in URLs.
    """
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"), default=argument_to_json)
    if ":/" in text:
        text = json.dumps(stored(json.loads(text)), sort_keys=True, separators=(",", ":"))
    return digest_of_bytes(text.encode())


def argument_to_json(value: Any) -> Any:
    """Convert a value in the arguments of a task for JSON: a dataclass to its fields, a fraction to text."""
    if isinstance(value, Fraction):
        return str(value)
    if is_dataclass(value):
        return {
            f.name: getattr(value, f.name)
            for f in fields(value)
            if f.metadata.get("digest", True)
        }
    raise TypeError(
        f"{type(value).__name__} is not allowed in the arguments of a task; use a JSON-able value"
    )


def new_digest() -> hashlib.blake2b:
    """Return a BLAKE2b of 16 bytes, to which bytes can be added part by part."""
    return hashlib.blake2b(digest_size=16)


def digest_of_bytes(*parts: bytes) -> str:
    """Return the digest of bytes, one part after the other."""
    digest = new_digest()
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


def digest_of_arrays(*arrays: npt.NDArray[Any]) -> str:
    """Return one digest of the values of all arrays, row by row."""
    digest = new_digest()
    for array in arrays:  # One copy of an array at a time, since arrays may be large.
        digest.update(array.tobytes())
    return digest.hexdigest()
