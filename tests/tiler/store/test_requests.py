"""Requests of a store in a bucket, by the calls that s3fs makes; there is no server."""

from __future__ import annotations

from typing import Any

import pytest

from tiler.store.storage import Storage

s3fs = pytest.importorskip("s3fs")


class _Body:
    async def read(self) -> bytes:
        return b"bytes"

    def close(self) -> None:
        pass


def test_reading_an_object_is_one_request_whether_it_exists_or_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls = []

    async def answer(
        self: Any, method: str, *arguments: Any, **keywords: Any
    ) -> dict[str, Any]:
        calls.append((method, keywords["Key"]))
        if keywords["Key"].endswith("missing.json"):
            raise FileNotFoundError(keywords["Key"])
        return {"Body": _Body()}

    monkeypatch.setattr(s3fs.S3FileSystem, "_call_s3", answer)
    storage = Storage("s3://bucket/store.zarr")
    assert storage.get_many(["there.json", "missing.json"]) == [b"bytes", None]
    assert sorted(calls) == [
        ("get_object", "store.zarr/missing.json"),
        ("get_object", "store.zarr/there.json"),
    ]
