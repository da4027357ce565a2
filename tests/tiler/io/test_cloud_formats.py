"""A row of the table of formats is enough to read clouds of a format."""

from __future__ import annotations

import gzip
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import pytest

from tiler.apps.clouds import describe_cloud
from tiler.inputs import inspect
from tiler.io.cloud_formats import FORMATS, CloudFormat
from tiler.io.las.headers import read_header
from tiler.io.las.reader import PointReader


def open_packed(path: Path, _: int, parts: Sequence[tuple[int, int]]) -> BinaryIO:
    return io.BytesIO(gzip.decompress(path.read_bytes()))


def test_cloud_of_another_format_is_read_as_las(
    make_cloud: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(FORMATS, ".packed", CloudFormat("packed LAS", open_packed))
    source = make_cloud("a.las", n=2000)
    packed = source.with_suffix(".Packed")
    packed.write_bytes(gzip.compress(source.read_bytes()))
    expected, found = inspect(source), inspect(packed)
    assert found.points == expected.points == 2000
    assert found.bounds == expected.bounds
    assert found.size == packed.stat().st_size < expected.size
    with PointReader(read_header(source)) as one, PointReader(read_header(packed)) as other:
        assert one.read(700, 900).tobytes() == other.read(700, 900).tobytes()
    facts = describe_cloud(packed)
    assert (facts["format"], facts["las_version"]) == ("packed LAS", None)
    assert describe_cloud(source)["las_version"] == "1.2"
