"""`tiler clean`: what goes, what stays, and that later runs end as if nothing had gone."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.invariants import clouds
from tests.invariants.runs import computed, do, output_digests, the_store
from tiler.clean import clean
from tiler.errors import ConfigError, LockedError, StoreError


def test_a_clean_store_is_smaller_and_everything_in_it_is_done(tmp_path: Path) -> None:
    out, fresh = tmp_path / "out", tmp_path / "fresh"
    west = clouds.write(tmp_path / "west.laz", clouds.city(96.0))
    moved = clouds.city(96.0, seed=2)
    east = clouds.write(tmp_path / "east.laz", clouds.Cloud(moved.xyz + [90.0, 0, 0], moved.truth))
    do([west], out)
    before, size = output_digests(out), the_store(out).usage().size_bytes
    left = [
        out / "store.zarr" / "points" / "xyz" / f"0.{32 * 'a'}.partial",
        out / ".tiler-dtm.tif.cog.partial",
    ]
    for path in left:
        path.write_bytes(b"scratch")

    found = clean(out)
    assert found["scratch_files"] == 1
    assert not any(path.exists() for path in left)
    assert not the_store(out).pieces()
    assert found["removed_bytes"] > 0
    assert the_store(out).usage().size_bytes < size
    assert clean(out)["removed_objects"] == 0

    again = do([west], out)
    assert again.did_nothing
    assert output_digests(out) == before

    more = do([west, east], out)
    assert more.exit_code == 0
    assert computed(more)["spool"] == 1, "of the file from before, what touches the new one's buckets"
    do([west, east], fresh)
    assert output_digests(out) == output_digests(fresh)


def test_what_is_no_run_is_refused_and_a_running_one_left_alone(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such folder"):
        clean(tmp_path / "nowhere")
    with pytest.raises(StoreError, match="no tile store here"):
        clean(tmp_path)
    out = tmp_path / "out"
    do([clouds.write(tmp_path / "a.laz", clouds.city(64.0))], out, until="ingest")
    with the_store(out).lock(), pytest.raises(LockedError):
        clean(out)
