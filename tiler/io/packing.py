"""Names of packed files: gzip, zip and others, which no reader unpacks."""

from __future__ import annotations

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
