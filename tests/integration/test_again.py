"""A second run on the same OUT does what is new, and no more."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from tests.invariants import clouds
from tests.invariants.clouds import Cloud
from tests.invariants.runs import (
    assert_same_terrain,
    classes_by_point,
    computed,
    do,
    dtm,
    output_digests,
    the_store,
)
from tests.scenes.finished import Finished
from tiler.core.lattice import Cell
from tiler.core.points import unpack_origin
from tiler.core.records import TileRecord
from tiler.errors import ConfigError, InputError, ProcessingError
from tiler.filter.reading import FilterTile
from tiler.filter.tile import filter_tile
from tiler.grid.flaws import Advice
from tiler.simulate import DemoScene
from tiler.store import TileStore

pytestmark = pytest.mark.usefixtures("small_buckets")

GROUND = (
    "grid-dtm",
    "grid-water-ground",
    "grid-water-planes",
    "grid-water-areas",
    "grid-dtm-outlined",
    "grid-dtm-above",
)
"""Rasters that depend on the ground,"""
PIXELS = ("grid-survey", "grid-domain")
"""on the size of pixels besides the points,"""
POINTS = ("grid-occupancy", "grid-survey-open", "grid-domain-open")
"""and on the points alone."""


@pytest.fixture
def out(finished_run: Finished, demo: DemoScene, tmp_path: Path) -> Path:
    """A copy of a finished OUT, to go on with: files that are copied are written once more."""
    shutil.copytree(finished_run[0], tmp_path / "out")
    assert again(demo, tmp_path / "out") == {"export": 8, "catalogue": 2}
    return tmp_path / "out"


def again(demo: DemoScene, out: Path, **changes: Any) -> dict[str, int]:
    """Tasks that a run on all files computes, by stage; only those stages that computed something."""
    result = do(list(demo.paths), out, **{"tile_size": "128", "water": "auto", **changes})
    assert result.exit_code == 0
    assert result.did_nothing == (not any(computed(result).values()))
    return {stage: n for stage, n in computed(result).items() if n}


def test_nothing_new_is_nothing_done(out: Path, demo: DemoScene) -> None:
    before = output_digests(out)
    stamps = {
        p: p.stat().st_mtime_ns for p in (out / "dtm.tif", *(out / "classified").iterdir())
    }
    assert again(demo, out) == {}
    assert output_digests(out) == before
    assert {p: p.stat().st_mtime_ns for p in stamps} == stamps


def test_touched_files_are_read_but_not_decoded(out: Path, demo: DemoScene) -> None:
    for path in demo.paths:
        path.touch()
    assert again(demo, out) == again(demo, out, verify=True) == {}


def test_advice_on_the_terrain_is_given_again(
    out: Path, demo: DemoScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "tiler.grid.flaws.roofs_in_terrain", lambda *_: Advice("a roof", 1.0, 2.0)
    )
    assert again(demo, out, parameters={"max_building_size": "19"})["grid-dtm"]
    monkeypatch.undo()
    monkeypatch.setattr(
        "tiler.grid.flaws.roofs_in_terrain", lambda *_: pytest.fail("looked again")
    )
    options = {
        "parameters": {"max_building_size": "19"},
        "products": "dtm,slope",
        "tile_size": "128",
    }
    summary = do(list(demo.paths), out, **options).summary
    assert summary["advice"] == ["a roof"]
    assert [p["where"] for p in summary["problems"] if p["why"] == "a roof"] == [
        (1.0, 2.0, 1.0, 2.0)
    ]


def test_another_resolution_only_grids(out: Path, demo: DemoScene) -> None:
    once = (*GROUND, *PIXELS, "export", "catalogue")
    files = {"export": 2}  # the terrain, and its outline, which follows the pixels
    assert again(demo, out, resolution="0.5") == {**dict.fromkeys(once, 1), **files}


def test_two_resolutions_from_one_store(demo: DemoScene, tmp_path: Path) -> None:
    """Each OUT has files of its own, and each resolution has rasters: alternate runs repeat nothing."""
    runs = {
        tmp_path / "a": {"resolution": "1"},
        tmp_path / "b": {"resolution": "0.5"},
    }
    store, made = str(tmp_path / "s.zarr"), []
    for out, changes in runs.items():
        again(demo, out, store=store, **changes)
        made.append(output_digests(out))
    for _ in range(2):
        for out, changes in runs.items():
            assert again(demo, out, store=store, **changes) == {}
    assert [output_digests(out) for out in runs] == made
    assert not any((out / "outdated").exists() for out in runs)


def test_another_parameter_filters_but_does_not_ingest(out: Path, demo: DemoScene) -> None:
    found = again(demo, out, parameters={"iteration_distance": "1.3"})
    assert found.keys() == {"filter0", *GROUND, "grid-occupancy", "export", "catalogue"}


def test_other_rules_of_a_checkout_filter_and_grid_but_do_not_ingest(
    out: Path, demo: DemoScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tiler.schedule.task.RULES", "0.1.0-other")
    made = {"filter0", *GROUND, *PIXELS, *POINTS}
    assert made <= again(demo, out).keys() <= made | {"export", "catalogue"}


def test_cells_that_the_store_was_not_made_for_are_told(out: Path, demo: DemoScene) -> None:
    found = do(list(demo.paths), out, until="filter", parameters={"thin_cell": "0.7"}).summary[
        "notes"
    ]
    assert any("passes read all points" in text and "0.7 m" in text for text in found)


def test_other_classes_to_keep_leave_the_decoding(out: Path, demo: DemoScene) -> None:
    assert again(demo, out, keep_classes="7")["assemble"] > 0
    assert "spool" not in again(demo, out, keep_classes="7,18")


def test_a_lost_output_is_written_again(out: Path, demo: DemoScene) -> None:
    before = output_digests(out)
    (out / "dtm.tif").unlink()
    (out / "classified" / demo.paths[0].name).write_bytes(b"half")
    assert again(demo, out) == {"export": 2}
    assert output_digests(out) == before


def test_overwrite_starts_anew(out: Path, demo: DemoScene) -> None:
    every = {"spool", "assemble", "filter0", *GROUND, *PIXELS, *POINTS, "export", "catalogue"}
    assert again(demo, out, overwrite=True).keys() == every


def test_clean_store_leaves_the_results_alone(out: Path, demo: DemoScene) -> None:
    before = output_digests(out)
    assert again(demo, out, clean_store=True) == {}
    assert output_digests(out) == before
    assert not (out / "store.zarr").exists()


def test_a_store_of_another_crs_is_refused(out: Path, tmp_path: Path) -> None:
    other = clouds.write(tmp_path / "other.laz", clouds.city(100.0), crs="EPSG:25833")
    with pytest.raises(
        ConfigError, match=r"contains points in .*; use --overwrite or another -o"
    ):
        do(other, out)


@pytest.mark.slow
def test_an_added_file_redoes_only_what_it_can_reach(tmp_path: Path) -> None:
    # A strip of more than a kilometre, of which the last piece comes later.
    hills = clouds.city(200.0, 0.5, kind="hills")
    west = hills.take(hills.xyz[:, 1] < 60)
    pieces = [Cloud(west.xyz + (200.0 * i, 0.0, 0.0), west.truth) for i in range(6)]
    paths = [
        clouds.write(tmp_path / "in" / f"{i}.laz", piece) for i, piece in enumerate(pieces)
    ]
    out = tmp_path / "out"
    first = do(paths[:-1], out, tile_size="96", halo=40)
    result = do(paths, out, tile_size="96", halo=40)
    assert computed(result)["spool"] == 1
    tiles, redone = result.summary["filter"]["tiles"], computed(result)["filter0"]
    assert first.summary["filter"]["tiles"] < tiles
    assert redone < tiles / 2
    alone = do(paths, tmp_path / "alone", tile_size="96", halo=40)
    assert alone.exit_code == 0
    assert output_digests(out) == output_digests(tmp_path / "alone")


def test_a_file_left_out_later_is_gone_from_the_terrain(
    demo: DemoScene, out: Path, tmp_path: Path
) -> None:
    do(list(demo.paths[:3]), out, tile_size="128")
    do(list(demo.paths[:3]), tmp_path / "alone", tile_size="128")
    assert_same_terrain(out, tmp_path / "alone")


def test_a_changed_file_is_read_again(demo: DemoScene, tmp_path: Path) -> None:
    paths = [Path(shutil.copy(p, tmp_path / p.name)) for p in demo.paths[:2]]
    do(paths, tmp_path / "out", tile_size="128")
    shutil.copy(demo.truth_paths[0], paths[0])
    result = do(paths, tmp_path / "out", tile_size="128")
    assert computed(result)["spool"] == 1
    do(paths, tmp_path / "alone", tile_size="128")
    assert output_digests(tmp_path / "out") == output_digests(tmp_path / "alone")


@pytest.mark.parametrize(
    ("part", "in_process"),
    [
        ((1 / 8, 1 / 4), True),
        # Times of day that are garbled let the decoder overflow its stack: a worker ends, and
        # no other file suffers.
        pytest.param((1 / 3, 5 / 6), False, marks=pytest.mark.slow),
    ],
)
def test_a_corrupt_file_among_good_ones_is_left_out(
    part: tuple[float, float], in_process: bool, demo: DemoScene, tmp_path: Path
) -> None:
    cut = tmp_path / "cut.laz"
    cut.write_bytes(demo.paths[3].read_bytes()[:-3000])
    garbled = tmp_path / "garbled.laz"
    content = bytearray(demo.paths[3].read_bytes())
    first, end = (int(share * len(content)) for share in part)
    content[first:end] = b"\xff" * (end - first)
    garbled.write_bytes(content)
    result = do(
        [*demo.paths[:3], cut, garbled],
        tmp_path / "out",
        tile_size="128",
        in_process=in_process,
    )
    assert result.exit_code == 5
    assert {Path(q["path"]).name for q in result.summary["quarantined"]} == {
        "cut.laz",
        "garbled.laz",
    }
    assert all(q["error"] and "\n" not in q["error"] for q in result.summary["quarantined"])
    do(list(demo.paths[:3]), tmp_path / "alone", tile_size="128")
    assert_same_terrain(tmp_path / "out", tmp_path / "alone")
    assert np.array_equal(
        classes_by_point(tmp_path / "out"), classes_by_point(tmp_path / "alone")
    )


def test_a_corrupt_file_stops_a_strict_run(demo: DemoScene, tmp_path: Path) -> None:
    cut = tmp_path / "cut.laz"
    cut.write_bytes(demo.paths[3].read_bytes()[:-3000])
    with pytest.raises(InputError, match="cut.laz"):
        do([*demo.paths[:3], cut], tmp_path / "out", on_error="stop")


def assert_classes_of_the_input(out: Path, demo: DemoScene, cells: list[list[int]]) -> None:
    """The points of these buckets have the class of their source in the classified files."""
    store = the_store(out)
    numbers = {
        entry["number"]: Path(path) for path, entry in store.get_state("sources").items()
    }
    origin = np.concatenate(
        [store.read_bucket(Cell(*cell), ("origin",)).origin for cell in cells]
    )
    sources, rows = unpack_origin(origin)
    assert len(rows) > 100
    for number in np.unique(sources):
        mine, path = rows[sources == number], numbers[int(number)]
        before, after = laspy.read(path), laspy.read(out / "classified" / path.name)
        assert np.array_equal(before.classification[mine], after.classification[mine])


def test_a_tile_that_fails_leaves_no_old_labels(
    demo: DemoScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    do(list(demo.paths), out, tile_size="128")
    before, _ = dtm(out)
    _, (_, record) = max(the_store(out).committed("filter0").items())
    broken = record["cells"]

    def fails(store: TileStore, *, work: FilterTile) -> TileRecord:
        if [[cell.ix, cell.iy] for cell in work.cells] == broken:
            raise ProcessingError("this tile fails")
        return filter_tile(store, work=work)

    monkeypatch.setattr("tiler.filter.tasks.passes.filter_tile", fails)
    # Kernels and neighbours are sound: the run goes on, says so, and knows nothing of the tile.
    result = do(
        list(demo.paths), out, parameters={"iteration_distance": "1.39"}, tile_size="128"
    )
    assert result.exit_code == 5
    assert [f["error"] for f in result.summary["failed_tasks"]] == ["this tile fails"]
    store = the_store(out)
    assert all(not store.read_labels("labels", Cell(*cell)).any() for cell in broken)
    after, _ = dtm(out)
    assert (after != before).any()
    assert_classes_of_the_input(out, demo, broken)
    monkeypatch.undo()
    monkeypatch.setattr("tiler.plan.sizes.BUCKET_POINTS", 1000)
    mended = do(
        list(demo.paths), out, parameters={"iteration_distance": "1.39"}, tile_size="128"
    )
    assert mended.exit_code == 0
    assert computed(mended)["filter0"] == 1


@pytest.mark.slow
def test_a_tile_that_fails_stops_a_strict_run(
    demo: DemoScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: Any, **__: Any) -> TileRecord:
        raise ZeroDivisionError("no tile succeeds")

    monkeypatch.setattr("tiler.filter.tasks.passes.filter_tile", fails)
    with pytest.raises(
        ProcessingError, match="ZeroDivisionError: no tile succeeds .*--on-error skip"
    ):
        do(list(demo.paths[:1]), tmp_path / "out", on_error="stop")
    with pytest.raises(
        ProcessingError, match=r"^no tile could be filtered; the first error: ZeroDivisionError"
    ):
        do(list(demo.paths[:1]), tmp_path / "out")
    assert '"state": "failed"' in (tmp_path / "out" / "run.json").read_text()
