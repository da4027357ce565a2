from __future__ import annotations

import io
from typing import Any

import pytest

from tiler.io.las.headers import read_header
from tiler.io.las.reader import EVERYTHING, PointReader
from tiler.io.las.writers import PointWriter


class Full(io.BytesIO):
    """A disk without space."""

    def write(self, data: Any) -> int:
        raise OSError(28, "No space left on device")


def test_a_full_disk_is_an_os_error(make_cloud: Any) -> None:
    header = read_header(make_cloud("a.las", n=200_000))
    with PointReader(header, EVERYTHING) as reader:
        records = reader.read(0, 200_000)

    def fill() -> None:
        writer = PointWriter(Full(), header)
        writer.write(records)
        writer.close()

    with pytest.raises(OSError, match="write"):
        fill()
