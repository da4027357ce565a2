"""An object store: whose objects are whose, and every command that takes a path takes a URL."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

import tiler
from tests.integration.cloud import BUCKET
from tests.invariants import clouds
from tests.invariants.runs import settings
from tiler.apps.clean import clean
from tiler.apps.info import describe
from tiler.config import RunConfig
from tiler.errors import ConfigError, LockedError, TilerError
from tiler.pipeline import run
from tiler.report.html import write_report_at
from tiler.store import locked_folder

pytestmark = pytest.mark.slow


def test_results_and_store_by_url(
    bucket: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    cloud = clouds.write(tmp_path / "hill.laz", clouds.city(60.0, 1.0))
    out = f"s3://{BUCKET}/town"

    def do(**changes: Any) -> Any:
        return run([str(cloud)], out, settings(**changes))

    for name in ("dtm.tif", "classified/hill.laz"):
        bucket.pipe_file(f"{BUCKET}/town/{name}", b"mine")
    with pytest.raises(ConfigError, match="dtm.tif, classified/hill.laz: already exists"):
        do()
    assert do(force=True).exit_code == 0
    bucket.pipe_file(f"{BUCKET}/town/store.zarr/points/notes.txt", b"mine")
    with locked_folder(out), pytest.raises(LockedError, match=f"{out}: in use by"):
        do(store=f"s3://{BUCKET}/another.zarr")
    for path in (tmp_path / "town").iterdir():
        path.unlink()  # as from another machine
    assert do().did_nothing
    assert do(overwrite=True, clean_store=True).exit_code == 0
    assert bucket.find(f"{BUCKET}/town/store.zarr") == [
        f"{BUCKET}/town/store.zarr/points/notes.txt"
    ]
    assert not [name for name in bucket.find(f"{BUCKET}/town") if "lock" in name]
    assert json.loads(bucket.cat(f"{BUCKET}/town/run.json"))["state"] == "done"
    with pytest.raises(ConfigError, match=f"--store s3://{BUCKET}/: contains {out}"):
        do(store=f"s3://{BUCKET}/")
    bucket.put_file(str(cloud), f"{BUCKET}/hill.laz")
    summary = run([f"s3://{BUCKET}"], "other", settings()).summary
    assert [entry["path"] for entry in summary["inputs"]] == [f"s3://{BUCKET}/hill.laz"]


@pytest.mark.processes
def test_a_real_cloud_has_the_same_bytes_everywhere(
    bucket: Any, shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One and two workers, three tile sizes, two memories, here and in a bucket: 112 m of a mountain village."""
    monkeypatch.chdir(tmp_path)
    whole = laspy.read(shared_data / "dim" / "Churo_dim.laz")
    x, y = (np.asarray(axis) - axis.min() for axis in (whole.x, whole.y))
    cut = laspy.LasData(whole.header)
    cut.points = whole.points[(x > 600) & (x < 712) & (y > 800) & (y < 912)]
    cut.write(tmp_path / "churo.laz")

    def do(out: str, **changes: Any) -> None:
        config = RunConfig.from_mapping({"crs": "EPSG:32718", **changes})
        assert run(["churo.laz"], out, config).exit_code == 0

    do("two", workers=2)
    do("one", workers=1, tile_size="40", memory="1GiB")
    do("small", workers=2, tile_size="80", memory="4GiB")
    do(f"s3://{BUCKET}/churo", workers=2)
    for name in ("dtm.tif", "classified/churo.laz"):
        expected = (tmp_path / "two" / name).read_bytes()
        assert bucket.cat(f"{BUCKET}/churo/{name}") == expected
        assert [
            (tmp_path / out / name).read_bytes() == expected for out in ("one", "small")
        ] == [True, True]


def test_every_command_takes_urls(
    bucket: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same as of files; what is not there is one line."""
    monkeypatch.chdir(tmp_path)
    cloud = clouds.write(tmp_path / "hill.laz", clouds.city(60.0, 1.0))
    bucket.put_file(str(cloud), f"{BUCKET}/clouds/hill.laz")
    url, out = f"s3://{BUCKET}/clouds/hill.laz", f"s3://{BUCKET}/hill"
    run([url], out, settings())
    run([str(cloud)], tmp_path / "here", settings())
    assert bucket.cat(f"{BUCKET}/hill/dtm.tif") == (tmp_path / "here/dtm.tif").read_bytes()
    dtms = (f"{out}/dtm.tif", tmp_path / "here/dtm.tif")
    for there, here in ((url, cloud), (out, tmp_path / "here"), dtms):
        found, same = describe(str(there)), describe(str(here))
        assert found.pop("path") == there
        assert found.keys() - {"store"} == same.keys() - {"path", "store"}
        assert found.get("heights") == same.get("heights")
    assert describe(f"{out}/store.zarr")["points"] == describe(url)["points"]
    (tmp_path / "points.csv").write_text("x,y,z\n500020,5400020,100\n")
    accuracies = [
        tiler.check(dtm, tmp_path / "points.csv").summary["accuracy"]["nva"] for dtm in dtms
    ]
    assert accuracies[0] == accuracies[1]
    checked = tiler.check(out, tmp_path / "points.csv", require=["points=2"])
    assert (checked.exit_code, checked.report) == (5, f"{out}/report.html")
    assert b"1 requirement is not met" in bucket.cat(f"{BUCKET}/hill/report.html")
    assert json.loads(Path("hill/check.json").read_text())["accuracy"]["nva"] == accuracies[0]
    tiler.classify(url, "there.laz", settings())
    tiler.classify(cloud, "same.laz", settings())
    assert (tmp_path / "there.laz").read_bytes() == (tmp_path / "same.laz").read_bytes()
    bucket.rm_file(f"{BUCKET}/hill/report.html")
    assert write_report_at(out) == f"{out}/report.html"
    assert b"Terrain of hill" in bucket.cat(f"{BUCKET}/hill/report.html")
    assert clean(out).store_bytes > 0
    assert run([url], out, settings()).did_nothing
    for refused, line in (
        (lambda: describe(f"s3://{BUCKET}/none"), f"s3://{BUCKET}/none: no tile store here"),
        (
            lambda: tiler.check(f"{out}/no.tif", "points.csv"),
            f"{out}/no.tif: nothing there; give a raster",
        ),
        (
            lambda: tiler.classify(f"{out}/no.laz", "a.laz"),
            rf"{out}/no.laz: cannot be read \(nothing is there\); check the URL",
        ),
        (
            lambda: tiler.classify(url, f"{out}/a.laz"),
            f"{out}/a.laz: one file is written here; give a file",
        ),
        (
            lambda: write_report_at(f"s3://{BUCKET}/none"),
            f"s3://{BUCKET}/none/run.json: cannot be read",
        ),
    ):
        with pytest.raises(TilerError, match=f"^{line}"):
            refused()
