"""What run.json says of a run."""

from __future__ import annotations

import os
from dataclasses import replace

import pytest

from tests.tiler.conftest import MakeCloud
from tiler.config import RunConfig
from tiler.plan import make_plan
from tiler.runs.record import RunRecord


def test_paths_have_slashes_where_the_system_has_others(
    make_cloud: MakeCloud, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = make_plan([str(make_cloud())], RunConfig.from_mapping({"method": "classic"}))
    config = plan.config.updated(
        edits=r"C:\job\edits.gpkg", breaklines=(r"C:\job\lines.gpkg",), store=r"D:\store.zarr"
    )
    cloud = r"C:\job\town.laz"
    inputs = replace(plan.inputs, left_out=((cloud, "no good"),))
    record = RunRecord()
    with monkeypatch.context() as windows:
        windows.setattr(os, "sep", "\\")
        record.leave_out(cloud, rf"{cloud}: no good; copy \\server\town.laz again")
        content = record.content(replace(plan, config=config, inputs=inputs), "done")
    assert content["quarantined"] == [
        {
            "path": "C:/job/town.laz",
            "error": r"C:/job/town.laz: no good; copy \\server\town.laz again",
        }
    ]
    assert content["plan"]["unreadable"] == [["C:/job/town.laz", "no good"]]
    settings = content["configuration"]
    assert [settings[name] for name in ("edits", "breaklines", "store", "aoi", "water")] == [
        "C:/job/edits.gpkg", ["C:/job/lines.gpkg"], "D:/store.zarr", None, "auto",
    ]  # fmt: skip
