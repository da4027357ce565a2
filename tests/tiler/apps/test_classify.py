"""One file to one file: early refusals, and the names of failed tiles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import laspy
import pytest

from cli.main import main
from tests.invariants import clouds
from tests.invariants.runs import settings
from tiler.apps.classify import classify_file
from tiler.apps.evaluate import filter_and_evaluate
from tiler.apps.preview import make_preview
from tiler.config import RunConfig
from tiler.core.records import TileRecord
from tiler.errors import ConfigError, ProcessingError
from tiler.filter.reading import FilterTile
from tiler.filter.tasks import passes
from tiler.filter.tile import filter_tile
from tiler.observe.events import Event, Warned
from tiler.store import TileStore


def test_a_folder_that_cannot_be_made_is_refused(make_cloud: Any, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(ConfigError, match=r"b\.laz: its folder cannot be made or written \("):
        classify_file(
            make_cloud("a.las", n=20),
            tmp_path / "file" / "sub" / "b.laz",
            RunConfig(in_process=True),
        )


@pytest.mark.skipif(
    not Path("/proc/self").exists(), reason="no folder here that root cannot write"
)
def test_a_folder_that_cannot_be_written_is_refused(make_cloud: Any) -> None:
    with pytest.raises(ConfigError, match=r"b\.laz: its folder cannot be made or written \("):
        classify_file(
            make_cloud("a.las", n=20), Path("/proc/self/b.laz"), RunConfig(in_process=True)
        )


@pytest.fixture
def cloud(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cloud of several tiles with all points of class 6; the first tile fails."""
    monkeypatch.setattr("tiler.plan.sizes.BUCKET_POINTS", 1000)
    failing: list[object] = []

    def fails_once(store: TileStore, *, work: FilterTile) -> TileRecord:
        if work.cells in (failing or [work.cells]):
            failing[:] = [work.cells]
            raise ProcessingError("this tile fails")
        return filter_tile(store, work=work)

    monkeypatch.setattr(passes, "filter_tile", fails_once)
    points = clouds.city(150.0, 1.0)
    return clouds.write(tmp_path / "in.laz", points, classes=points.truth * 0 + 6)


def test_a_tile_that_fails_is_named(cloud: Path, tmp_path: Path) -> None:
    facts = classify_file(cloud, tmp_path / "out.laz", settings())
    (failed,) = facts["failed_tasks"]
    assert facts["exit_code"] == 5
    assert failed["error"] == "this tile fails"
    kept = laspy.read(tmp_path / "out.laz")
    west, south, east, north = failed["bounds"]
    inside = (kept.x >= west) & (kept.x < east) & (kept.y >= south) & (kept.y < north)
    assert inside.sum() > 100
    assert set(kept.classification[inside]) == {6}
    assert 2 in set(kept.classification[~inside])


def test_the_command_ends_with_5(
    cloud: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("cli.commands.classify.read_config", lambda _: settings())
    assert main(["classify", str(cloud), str(tmp_path / "out.laz")]) == 5
    told = capsys.readouterr()
    assert "failed      filter: seeds, densification, labels t" in told.out
    assert ": this tile fails" in told.out
    assert "warning: filter: seeds, densification, labels t" in told.err


def test_labels_with_a_hole_are_not_scored(cloud: Path) -> None:
    with pytest.raises(
        ProcessingError,
        match=r"in\.laz: not scored, as 1 of its tasks failed \(filter: seeds, densification, labels t",
    ):
        filter_and_evaluate([cloud], settings())


def test_a_preview_with_a_hole_says_so(cloud: Path, tmp_path: Path) -> None:
    told: list[str] = []

    def listen(event: Event) -> None:
        if isinstance(event, Warned):
            told.append(event.text)

    windows = make_preview(
        [str(cloud)], tmp_path / "preview.png", settings(), listen, number=1, side_m=140.0
    )
    assert [window.failed for window in windows] == [1]
    assert any("this tile fails" in text for text in told)


@pytest.mark.parametrize("name", ["out.laz", "out.las", "out.copc.laz"])
@pytest.mark.parametrize(
    ("own", "given", "written"),
    [(None, 32633, 32633), (32632, 32633, 32632), (None, None, None)],
)
def test_the_crs_given_is_written_where_the_file_has_none(
    name: str, own: int | None, given: int | None, written: int | None, tmp_path: Path
) -> None:
    path = clouds.write(tmp_path / "in.laz", clouds.city(30.0, 1.0), crs=own and f"EPSG:{own}")
    classify_file(path, tmp_path / name, settings(crs=given and f"EPSG:{given}"))
    crs = laspy.read(tmp_path / name).header.parse_crs()
    assert (crs and crs.to_epsg()) == written
