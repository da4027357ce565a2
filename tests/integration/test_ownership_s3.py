"""Whose objects are whose in an object store: results, a store and the leases by URL."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.integration.cloud import BUCKET, object_store
from tests.invariants import clouds
from tests.invariants.runs import settings
from tiler.errors import ConfigError, LockedError
from tiler.pipeline import run
from tiler.store import locked_folder

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def bucket() -> Iterator[Any]:
    """The file system of an S3 server whose variables are those of this process."""
    pytest.importorskip("moto.server", reason="no S3 server: moto is not installed")
    pytest.importorskip("upath")
    s3fs = pytest.importorskip("s3fs")
    with object_store() as variables, pytest.MonkeyPatch.context() as patch:
        for name, value in variables.items():
            patch.setenv(name, value)
        system = s3fs.S3FileSystem(use_listings_cache=False)
        system.mkdir(BUCKET)
        yield system
        s3fs.S3FileSystem.clear_instance_cache()


def test_results_and_store_by_url(bucket: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    cloud = clouds.write(tmp_path / "hill.laz", clouds.city(60.0, 1.0))
    out = f"s3://{BUCKET}/town"

    def do(**changes: Any) -> Any:
        return run([str(cloud)], out, settings(**changes))

    for name in ("dtm.tif", "classified/hill.laz"):
        bucket.pipe_file(f"{BUCKET}/town/{name}", b"mine")
    with pytest.raises(ConfigError, match="dtm.tif, classified/hill.laz: there already"):
        do()
    assert do(force=True).exit_code == 0
    bucket.pipe_file(f"{BUCKET}/town/store.zarr/points/notes.txt", b"mine")
    with locked_folder(out), pytest.raises(LockedError, match=f"{out}: in use by"):
        do(store=f"s3://{BUCKET}/another.zarr")
    for path in (tmp_path / "town").iterdir():
        path.unlink()  # as from another machine
    assert do().did_nothing
    assert do(overwrite=True, clean_store=True).exit_code == 0
    assert bucket.find(f"{BUCKET}/town/store.zarr") == [f"{BUCKET}/town/store.zarr/points/notes.txt"]
    assert not [name for name in bucket.find(f"{BUCKET}/town") if "lock" in name]
    assert json.loads(bucket.cat(f"{BUCKET}/town/run.json"))["state"] == "done"
    with pytest.raises(ConfigError, match=f"--store s3://{BUCKET}/: holds {out}"):
        do(store=f"s3://{BUCKET}/")
    bucket.put_file(str(cloud), f"{BUCKET}/hill.laz")
    summary = run([f"s3://{BUCKET}"], "other", settings()).summary
    assert [entry["path"] for entry in summary["inputs"]] == [f"s3://{BUCKET}/hill.laz"]
