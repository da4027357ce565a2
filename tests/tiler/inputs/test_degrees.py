"""Degrees in files without a CRS are recognised by their density, and lengths near the origin are not."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from cli.main import main
from tests.integration.command import assert_one_line
from tiler.config import RunConfig
from tiler.core.units import FOOT, Units
from tiler.errors import InputError
from tiler.inputs.common_crs import resolve_common_crs
from tiler.inputs.sources import inspect

METRES_PER_DEGREE = 111_195.0
N = 2000


def rectangle(
    make_cloud: Any, x: float, y: float, width: float, height: float, n: int = N, **options: Any
) -> Path:
    """Write a cloud without a CRS whose points fill a rectangle."""
    rng = np.random.default_rng(3)

    def fill(cloud: laspy.LasData) -> None:
        cloud.x, cloud.y = x + rng.uniform(0, width, n), y + rng.uniform(0, height, n)

    path: Path = make_cloud(
        "a.las",
        n=n,
        edit=fill,
        **{"crs": None, "scales": (1e-7, 1e-7, 0.001), "offsets": (x, y, 0.0)} | options,
    )
    return path


def degrees(
    make_cloud: Any, longitude: float, latitude: float, density: float, **options: Any
) -> Path:
    """Write a square cloud in degrees with a density per m2 on the ground."""
    height = math.sqrt(N / density) / METRES_PER_DEGREE
    width = height / math.cos(math.radians(latitude))
    return rectangle(make_cloud, longitude, latitude, width, height, **options)


PLACES = [(8.0, 47.0), (-122.4, 37.8), (151.2, -33.9), (0.0, 0.0), (15.6, 78.2)]


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("density", [0.1, 4.0, 400.0])
@pytest.mark.parametrize("crs", [None, "none", "EPSG:25832"])
def test_degrees_are_refused_with_or_without_a_given_crs(
    make_cloud: Any, place: tuple[float, float], density: float, crs: str | None
) -> None:
    info = inspect(degrees(make_cloud, *place, density))
    with pytest.raises(
        InputError, match=r"look like degrees .*reproject it.*--units m"
    ) as caught:
        resolve_common_crs([info], RunConfig(crs=crs))
    assert str(info.path) in str(caught.value)


def test_swapped_axes_are_recognised_too(make_cloud: Any) -> None:
    with pytest.raises(InputError, match="look like degrees"):
        resolve_common_crs([inspect(rectangle(make_cloud, 35, 139, 1e-3, 1e-3))], RunConfig())


def test_degrees_with_units_are_taken_as_lengths(make_cloud: Any) -> None:
    info = inspect(degrees(make_cloud, 8.0, 47.0, 4.0))
    agreed = resolve_common_crs([info], RunConfig(crs="none", units="ft"))
    assert agreed.units == Units(FOOT, FOOT)


@pytest.mark.parametrize("side", [0.05, 0.5, 1.0, 5.0, 60.0])
@pytest.mark.parametrize("corner", [(0.0, 0.0), (-0.5, -0.5), (8.0, 47.0), (100.0, -80.0)])
def test_lengths_near_the_origin_are_read(
    make_cloud: Any, side: float, corner: tuple[float, float]
) -> None:
    info = inspect(rectangle(make_cloud, *corner, side, side))
    assert resolve_common_crs([info], RunConfig(crs="none")).units == Units()


@pytest.mark.parametrize("n", [1, 5, 100])
def test_few_points_at_one_position_are_read(make_cloud: Any, n: int) -> None:
    info = inspect(rectangle(make_cloud, 8.0, 47.0, 0.0, 0.0, n=n))
    assert resolve_common_crs([info], RunConfig(crs="none")).units == Units()


def test_profile_without_width_is_read(make_cloud: Any) -> None:
    info = inspect(rectangle(make_cloud, 0.0, 0.0, 50.0, 0.0))
    assert resolve_common_crs([info], RunConfig(crs="none")).units == Units()


@pytest.mark.parametrize(
    "command", ["plan IN --crs none", "run IN -o OUT --crs none", "classify IN OUT.laz"]
)
def test_each_command_refuses_degrees_with_one_line(
    make_cloud: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    path = degrees(make_cloud, 8.0, 47.0, 4.0)
    out = tmp_path / "out"
    words = command.replace("IN", str(path)).replace("OUT", str(out)).split()
    assert main(words) == 3
    assert_one_line(capsys.readouterr().err, str(path), "look like degrees")
    assert not (out / "dtm.tif").exists()
    assert not out.with_suffix(".laz").exists()


def test_many_points_at_one_position_are_no_degrees(make_cloud: Any) -> None:
    info = inspect(rectangle(make_cloud, 10.0, 20.0, 0.0, 0.0))
    assert resolve_common_crs([info], RunConfig(crs="none")).wkt is None
