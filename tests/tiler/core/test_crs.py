"""The scale of a CRS: lengths in its plane over lengths on the ground."""

from __future__ import annotations

import math

import pytest
from pyproj import CRS

from tiler.core.crs import point_scale_factor

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
