"""Tasks of the files: which sheets there are, and what makes a file new."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.invariants import clouds
from tests.scenes.records import bucket_record, spool_record
from tiler.config import RunConfig
from tiler.core.area import Area
from tiler.core.drawn_sheets import DrawnSheet
from tiler.core.lattice import Bounds, Cell
from tiler.core.raster import BLOCK_PIXELS
from tiler.export.tasks.files import Inputs, cog_tasks, inputs_of, mosaic_tasks, nodata_of
from tiler.export.tasks.sheets import height_tasks, sheet_finder, sheets
from tiler.grid.tasks.gridding import GridContext
from tiler.plan import Plan, make_plan
from tiler.runs.found import Gridded, IngestResult, Source

WEST, EAST = Cell(0, 0), Cell(1, 0)
"""Buckets on both sides of x = 500,000 m, whose points lie 10 to 40 m from there."""
HIGH = (Cell(499, 5400), Cell(500, 5400))
"""Sheets with heights."""


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    cloud = clouds.write(tmp_path_factory.mktemp("in") / "in.laz", clouds.city(20.0, 1.0))
    settings = {
        "products": ["dtm", "hillshade"],
        "resolution": "1",
        "sheets": "1000",
        "in_process": True,
    }
    return make_plan([str(cloud)], RunConfig.from_mapping(settings))


def gridding(plan: Plan, **bounds: tuple[int, int, int, int]) -> Gridded:
    """What the stage grid made of points in two buckets; bounds in metres from (500,000, 5,400,000)."""
    boxes = {"west": (-40, 10, -10, 40), "east": (10, 10, 40, 40), **bounds}
    records = {}
    for cell, name in ((WEST, "west"), (EAST, "east")):
        west, south, east, north = boxes[name]
        box = Bounds(500_000 + west, 5_400_000 + south, 500_000 + east, 5_400_000 + north)
        records[cell] = bucket_record(bounds=[1000 * side for side in box.to_json()])
    context = GridContext(plan, IngestResult(records, {WEST: "w", EAST: "e"}), {})
    blocks = list(context.spec.blocks(BLOCK_PIXELS))
    for raster in ("dtm", "dtm-outlined", "hillshade"):
        context.fills[raster] = 0.0
        context.made[raster] = {
            b.name: ("digest", {"checksum": f"{raster} {b.name}", "filled": 1}) for b in blocks
        }
    found = context.found()
    return found if plan.config.sheets is None else replace(found, sheets=sheets(found, HIGH))


def spooled(first: str, second: str, plan: Plan) -> Inputs:
    """Two files, of these contents: one with points in both buckets, one in the east alone."""
    sources = [
        Source(plan.inputs.sources[0], number, content)
        for number, content in enumerate((first, second))
    ]
    pieces: Any = {
        "s000000-0": ("", spool_record(buckets=[[0, 0, 3], [1, 0, 1]]).to_json()),
        "s000001-0": ("", spool_record(buckets=[[1, 0, 2]]).to_json()),
    }
    return inputs_of(sources, pieces)


def test_sheets_lie_on_multiples_of_their_side_and_have_the_buckets_of_their_points(
    plan: Plan,
) -> None:
    found = gridding(plan).sheets
    assert [(sheet.spec.edges[:2], sheet.cells) for sheet in found] == [
        ((499_000.0, 5_400_000.0), [WEST]),
        ((500_000.0, 5_400_000.0), [EAST]),
    ]
    assert {(sheet.spec.width, sheet.spec.height) for sheet in found} == {(1000, 1000)}
    across = gridding(plan, west=(-40, -5, 10, 40)).sheets
    assert [sheet.cells for sheet in across] == [[WEST], [WEST, EAST]]


def test_a_position_on_a_shared_edge_is_in_one_sheet(plan: Plan) -> None:
    west, east = gridding(plan).sheets
    sheet_at = sheet_finder([west, east])
    assert sheet_at(499_999.999, 5_400_000.0) is west
    assert sheet_at(500_000.0, 5_400_999.999) is east
    assert sheet_at(500_000.0, 5_401_000.0) is None
    assert sheet_at(498_999.999, 5_400_500.0) is None
    assert sheet_finder([])(500_000.0, 5_400_500.0) is None


def test_a_position_is_in_the_first_of_the_drawn_sheets_that_contain_it(plan: Plan) -> None:
    west, east = gridding(plan).sheets
    ring = np.array([[0, 0], [100_000, 0], [0, 100_000]], np.int64) + [
        499_900_000,
        5_400_000_000,
    ]
    triangle = Area(((ring,),))
    drawn = [
        replace(west, drawn=DrawnSheet("lot", triangle)),
        replace(east, drawn=DrawnSheet("rest", Area.rectangle(west.spec.bounds))),
    ]
    sheet_at = sheet_finder(drawn)
    assert sheet_at(499_910.0, 5_400_010.0) is drawn[0]
    assert sheet_at(499_990.0, 5_400_090.0) is drawn[1]
    assert sheet_at(500_000.0, 5_400_000.0) is None


def test_heights_are_looked_for_in_the_models_that_were_made(plan: Plan) -> None:
    g = gridding(plan)
    (task,) = height_tasks(g)
    assert task.arguments["rasters"] == ("dtm-outlined",)
    (block,) = g.made["dtm-outlined"]
    g.made["dsm-outlined"] = {block: ("digest", {"checksum": "surface", "filled": 1})}
    (both,) = height_tasks(g)
    assert both.arguments["rasters"] == ("dtm-outlined", "dsm-outlined")
    assert both.digest != task.digest
    for raster in both.arguments["rasters"]:
        g.made[raster][block][1]["filled"] = 0
    assert not list(height_tasks(g))


def digests(g: Gridded, inputs: Inputs) -> dict[str, str]:
    return {task.key: task.digest for task in cog_tasks(g, inputs, "all", "OUT")}


def test_another_input_makes_new_sheets_where_it_lies(plan: Plan) -> None:
    g = gridding(plan)
    before = digests(g, spooled("a", "b", plan))
    after = digests(g, spooled("a", "c", plan))
    west, east = (
        [f"{name}_{x}_5400000.tif" for name in ("dtm", "hillshade")] for x in (499000, 500000)
    )
    assert set(before) == {*west, *east}
    assert {key for key in before if before[key] != after[key]} == set(east)
    everywhere = digests(g, spooled("d", "b", plan))
    assert not set(before.values()) & set(everywhere.values())


def test_another_block_makes_new_files_of_its_raster(plan: Plan) -> None:
    g, inputs = gridding(plan), spooled("a", "b", plan)
    before = digests(g, inputs)
    (block,) = g.made["hillshade"]
    g.made["hillshade"] = {block: ("digest", {"filled": 1, "checksum": "other"})}
    after = digests(g, inputs)
    assert {key for key in before if before[key] != after[key]} == {
        k for k in before if "hillshade" in k
    }


def test_one_file_and_no_mosaic_without_sheets(plan: Plan) -> None:
    whole = gridding(replace(plan, config=replace(plan.config, sheets=None)))
    tasks = list(cog_tasks(whole, spooled("a", "b", plan), "all", "OUT"))
    assert [task.key for task in tasks] == ["dtm.tif", "hillshade.tif"]
    assert {task.arguments["info"].tags["TILER_INPUTS"] for task in tasks} == {"all"}
    assert list(mosaic_tasks(whole, "all", "OUT")) == []
    mosaics = list(mosaic_tasks(gridding(plan), "all", "OUT"))
    assert [task.key for task in mosaics] == ["dtm.vrt", "hillshade.vrt"]
    paths = [f"dtm/dtm_{x}_5400000.tif" for x in (499000, 500000)]
    assert [path for path, _ in mosaics[0].arguments["sheets"]] == paths


def test_the_nodata_value_is_the_users_in_rasters_of_heights_alone(plan: Plan) -> None:
    asked = replace(plan, config=replace(plan.config, nodata=-999_999.0))
    assert [nodata_of(asked, name) for name in ("dtm", "slope")] == [-999_999.0] * 2
    assert [nodata_of(asked, name) for name in ("hillshade", "mask")] == [None] * 2
