"""Where STAC documents say that things are: on both sides of the antimeridian, and elsewhere."""

from __future__ import annotations

import pytest
import shapely
from pyproj import CRS, Transformer
from shapely.geometry import shape

from tiler.export.stac import Globe, hull_of

FIJI = CRS.from_epsg(3460)


def test_a_box_across_the_antimeridian_has_two_parts_that_hold_its_places() -> None:
    x, y = Transformer.from_crs(4326, FIJI, always_xy=True).transform(180.0, -16.8)
    box = (x - 2000, y - 2000, x + 3000, y + 2000)
    globe, back = Globe(FIJI.to_wkt()), Transformer.from_crs(FIJI, 4326, always_xy=True)
    found = globe.polygon(box)
    assert found is not None
    assert found["type"] == "MultiPolygon"
    place = shape(found)
    assert place.is_valid
    for east, inside in (
        (-2001, False),
        (-1990, True),
        (-5, True),
        (5, True),
        (2990, True),
        (3001, False),
    ):
        assert place.covers(shapely.Point(back.transform(x + east, y))) == inside
    assert place.area == pytest.approx(5000 * 4000 / 111_300**2 / 0.957, rel=0.02)
    west, _, east, _ = globe.bbox(box) or ()
    assert 179.9 < west < 180
    assert -180 < east < -179.9


def test_a_side_that_bulges_across_the_antimeridian_makes_no_empty_part(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    globe = Globe(FIJI.to_wkt())
    x, y = Transformer.from_crs(4326, FIJI, always_xy=True).transform(179.9, -16.8)
    monkeypatch.setattr(globe, "bbox", lambda box: [179.89, -16.82, -179.9999999, -16.78])
    found = globe.polygon((x - 2000, y - 2000, x, y))
    assert found is not None
    assert len(found["coordinates"]) == 1
    assert shape(found).is_valid


@pytest.mark.parametrize(
    ("boxes", "hull"),
    [
        ([(8, 48, 9, 49), (8.5, 47, 10, 48)], [8, 47, 10, 49]),
        ([(-1, 48, 1, 49), (1, 48, 3, 49)], [-1, 48, 3, 49]),
        (
            [(-125.1234567, 40, -124, 41), (-124, 40, -120.7, 42)],
            [-125.1234567, 40, -120.7, 42],
        ),
        ([(179, -17, -179.5, -16)], [179, -17, -179.5, -16]),
        (
            [(178, -17, 179, -16), (179, -17, -179, -16), (-179, -17, -178, -16)],
            [178, -17, -178, -16],
        ),
        ([(179, -17, 180, -16), (-180, -17, -179, -15)], [179, -17, -179, -15]),
        ([(-180, -90, 180, 90)], [-180, -90, 180, 90]),
    ],
)
def test_a_hull_is_the_narrowest(boxes: list[tuple[float, ...]], hull: list[float]) -> None:
    assert hull_of(boxes) == hull
