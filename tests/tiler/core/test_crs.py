"""The scale of a CRS (lengths in its plane over lengths on the ground), its area of use, and datums of heights."""

from __future__ import annotations

import math

import pytest
from pyproj import CRS, Proj
from pyproj.crs import CompoundCRS

from tiler.core.crs import (
    at_degrees,
    code_of,
    crs_warnings,
    misplaced,
    placement,
    point_scale_factor,
    same_vertical_datum,
)

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


@pytest.mark.parametrize(
    ("crs", "x", "y", "place"),
    [
        ("EPSG:32631", 85_036.0, 447_527.0, "4.04° N, 0.74° W"),  # of the Dutch grid
        ("EPSG:25831", 85_036.0, 447_527.0, "4.04° N, 0.74° W"),
        (
            "EPSG:25833",
            -30_000.0,
            6_700_000.0,
            None,
        ),  # western Norway, 7 degrees outside the zone
        ("EPSG:32718", 871_000.0, 8_503_000.0, None),  # Peru, 0.43 degrees outside the zone
        ("EPSG:28355", 900_000.0, 5_800_000.0, None),  # Victoria, in the next zone
        ("EPSG:28992", 85_036.0, 447_527.0, None),
        ("EPSG:28992", 290_000.0, 460_000.0, None),  # 11 km beyond the border
        ("EPSG:28992", 652_000.0, 6_862_000.0, "74.20° N, 172.13° E"),  # of the French grid
        ("EPSG:32631", 5e7, 4e7, "no place on Earth"),
        ("EPSG:2994", 637_000.0, 851_000.0, None),  # feet
        ("EPSG:2993", 637_000.0, 851_000.0, "49.36° N, 117.25° W"),  # feet taken as metres
        ("EPSG:27572", 600_000.0, 2_428_000.0, None),  # grads from Paris
        ("EPSG:31467", 3_500_000.0, 5_500_000.0, None),  # the first axis is north
        ("EPSG:5514", -740_000.0, -1_040_000.0, None),
        ("EPSG:3994", 9_000_000.0, -3_000_000.0, "33.73° S, 153.03° W"),
        ("EPSG:3994", 7_000_000.0, -3_000_000.0, None),  # beyond the antimeridian
        ("EPSG:3857", 1e6, 1e6, None),
        ("EPSG:3031", 0.0, 0.0, None),
    ],
)
def test_data_far_outside_the_area_of_use_have_a_warning(
    crs: str, x: float, y: float, place: str | None
) -> None:
    flat = CRS(crs)
    texts = [flat.to_wkt(), flat.to_wkt("WKT1_GDAL"), flat.to_3d().to_wkt()]
    texts.append(CompoundCRS("with heights", [flat, "EPSG:5703"]).to_wkt())
    for wkt in texts:
        found = misplaced(wkt, x, y)
        assert (found is None) is (place is None)
        assert place is None or f"the data lie at {place}, outside the area of use" in str(
            found
        )
    assert len(crs_warnings(texts[0], (x - 9, y - 9, 0, x + 9, y + 9, 9))) == (
        place is not None
    )


def test_the_place_of_data_in_a_wrong_crs_is_known_inside_its_area_of_use() -> None:
    wkt = CRS("EPSG:32631").to_wkt()
    assert misplaced(wkt, 180_000, 450_000) is None
    assert at_degrees(wkt, 180_000, 450_000) == ", data at 4.07° N, 0.12° E"
    local = 'LOCAL_CS["a mine",UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]'
    for unknown in (None, CRS(local).to_wkt()):
        assert at_degrees(unknown, 180_000, 450_000) == ""


def test_a_crs_without_a_known_area_has_no_warning() -> None:
    local = 'LOCAL_CS["a mine",UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]'
    own = CRS(
        "+proj=tmerc +lon_0=9.3 +k=0.99 +x_0=7000 +a=6378000 +b=6356000 +type=crs"
    ).to_wkt()
    for wkt in (None, CRS(local).to_wkt(), own, CRS("EPSG:4979").to_wkt()):
        assert misplaced(wkt, 1e6, 1e6) is None


@pytest.mark.parametrize(
    ("longitude", "outside_deg"), [(179.0, 0.0), (-172.0, 0.0), (150.0, 5.0), (-165.0, 4.99)]
)
def test_areas_may_contain_the_antimeridian(longitude: float, outside_deg: float) -> None:
    x, y = Proj("EPSG:3994")(longitude, -40.0)
    found = placement(CRS("EPSG:3994").to_wkt(), x, y)
    assert found is not None
    assert found.outside_deg == pytest.approx(outside_deg)


@pytest.mark.parametrize(
    "text", ["EPSG:25832", "ESRI:102970", "EPSG:5703", "+proj=tmerc +lon_0=9"]
)
def test_the_code_of_a_crs_is_that_of_each_of_its_texts(text: str) -> None:
    crs = CRS.from_user_input(text)
    expected = tuple(text.split(":")) if ":" in text else None
    assert code_of(crs) == code_of(CRS.from_wkt(crs.to_wkt())) == expected
    assert code_of(crs) == crs.to_authority()
