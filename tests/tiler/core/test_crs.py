"""The scale of a CRS (lengths in its plane over lengths on the ground), and datums of heights."""

from __future__ import annotations

import math

import pytest
from pyproj import CRS

from tiler.core.crs import point_scale_factor, same_vertical_datum

DEGREES = 111_319.49


@pytest.mark.parametrize(
    ("crs", "x", "y", "scale"),
    [
        ("EPSG:3857", 9 * DEGREES, 6_106_854.83, 1 / math.cos(math.radians(48))),
        ("EPSG:25832", 500_000.0, 5_400_000.0, 0.9996),
        ("EPSG:25832+7837", 500_000.0, 5_400_000.0, 0.9996),
        ("EPSG:2236", 656_166.67, 600_000.0, 1 - 1 / 17_000),
        ("EPSG:4979", 9.0, 48.0, None),
        ("EPSG:25832", math.inf, 0.0, None),
    ],
)
def test_the_scale_is_the_length_in_the_plane_over_that_on_the_ground(
    crs: str, x: float, y: float, scale: float | None
) -> None:
    found = point_scale_factor(CRS(crs).to_wkt(), x, y)
    assert found == (
        None if scale is None else pytest.approx(scale, rel=0.005 if scale > 1 else 1e-6)
    )


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        (5703, 6360, True),  # NAVD88 in metres and in US survey feet
        (5703, 5773, False),
        (5799, 5799, True),
        (5799, 9451, False),  # ensembles of Denmark and of the British Isles
        (5799, 10551, False),
        (10551, 10552, False),
    ],
)
def test_ensembles_of_datums_are_told_apart(one: int, other: int, same: bool) -> None:
    assert same_vertical_datum(CRS(one), CRS(other)) is same
    assert same_vertical_datum(CRS(other), CRS(one)) is same
