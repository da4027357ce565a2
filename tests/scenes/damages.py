"""Ways in which an object of a store is damaged."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import pytest


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def bomb(path: Path) -> None:
    """A chunk that says it unpacks to 2 GB, with a checksum that fits."""
    google_crc32c = pytest.importorskip("google_crc32c", reason="the checksums of zarr")

    data = bytearray(path.read_bytes()[:-4])
    struct.pack_into("<I", data, 4, 2_000_000_000)
    path.write_bytes(bytes(data) + struct.pack("<I", google_crc32c.value(bytes(data))))


DAMAGES: dict[str, Callable[[Path], None]] = {
    "gone": Path.unlink,
    "flipped": flip,
    "bomb": bomb,
}
