"""What made the clouds is found in the fields of their points, of all files together."""

from __future__ import annotations

import laspy
import numpy as np
import pytest

from ptd.matched.evidence import DIM, LIDAR
from tests.tiler.conftest import MakeCloud, without_sensor
from tiler.config import RunConfig
from tiler.errors import ConfigError
from tiler.plan import make_plan

NEXT_M = 1000.0


def grey(las: laspy.LasData) -> None:
    without_sensor(las)
    las.intensity[:] = (np.asarray(las.red) / 3 + las.green / 3 + las.blue / 3).astype(
        np.uint16
    )


def test_files_decide_before_a_point_is_filtered(make_cloud: MakeCloud) -> None:
    laser = make_plan([str(make_cloud("laser.las"))], RunConfig(in_process=True))
    matched = make_plan(
        [str(make_cloud("drone.las", point_format=2, edit=without_sensor))],
        RunConfig(in_process=True),
    )
    assert (laser.method.kind, matched.method.kind) == (LIDAR, DIM)
    said = make_plan([str(make_cloud("laser.las"))], RunConfig(in_process=True, kind="dim"))
    assert said.method.kind == DIM


def test_both_kinds_in_one_run_are_refused_unless_the_user_says_which(
    make_cloud: MakeCloud,
) -> None:
    places = [(500_000.0 + i * NEXT_M, 5_400_000.0, 0.0) for i in range(2)]
    clouds = [
        str(make_cloud("laser.las", offsets=places[0])),
        str(make_cloud("drone.las", point_format=2, offsets=places[1], edit=grey)),
    ]
    told = r"drone.las is a photogrammetric cloud \(98 % .*laser.las is a LiDAR cloud \(99 %"
    with pytest.raises(ConfigError, match=told):
        make_plan(clouds, RunConfig(in_process=True))
    assert make_plan(clouds, RunConfig(in_process=True, kind="als")).method.kind == LIDAR
    assert (
        make_plan(clouds, RunConfig(in_process=True, method="classic")).method.kind is not None
    )


def test_a_quiet_piece_of_the_same_writer_is_no_other_kind(make_cloud: MakeCloud) -> None:
    places = [(500_000.0 + i * NEXT_M, 5_400_000.0, 0.0) for i in range(4)]
    clouds = [
        str(
            make_cloud(
                f"{i}.las", offsets=place, seed=i, edit=without_sensor if i == 3 else None
            )
        )
        for i, place in enumerate(places)
    ]
    assert make_plan(clouds, RunConfig(in_process=True)).method.kind == LIDAR


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"kind": "als"}, "--kind als overrides that"),
        ({"preset": "city"}, "--preset city overrides that"),
        ({"preset": "dim", "kind": "als"}, "--kind als overrides that"),
        ({"kind": "als", "method": "keep"}, "--kind als overrides that"),
        ({"kind": "dim"}, None),
        ({"preset": "dim"}, None),
        ({"preset": "usgs"}, None),
        ({}, None),
    ],
)
def test_a_kind_that_the_points_contradict_is_told_of(
    settings: dict[str, str], told: str | None, make_cloud: MakeCloud
) -> None:
    cloud = str(make_cloud("drone.las", point_format=2, edit=grey))
    config = RunConfig.from_mapping({"in_process": True, **settings})
    found = [text for text in make_plan([cloud], config).warnings if "look like" in text]
    assert len(found) == (told is not None)
    for text in found:
        assert text.startswith("the points look like image matching (98 % sure: ")
        assert str(told) in text
        assert text.endswith("use --kind dim then")


def test_a_laser_scan_given_as_photogrammetric_is_told_of(make_cloud: MakeCloud) -> None:
    config = RunConfig.from_mapping({"in_process": True, "preset": "dim"})
    (text,) = make_plan([str(make_cloud("laser.las"))], config).warnings
    assert text.startswith("the points look like laser scanning (99 % sure: ")
    assert "--preset dim overrides that" in text
