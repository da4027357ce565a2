"""Vertical datums and units of heights of several files, and the vertical CRS of the rasters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import laspy
import pytest
from pyproj import CRS

from tiler.config import RunConfig
from tiler.core.crs import vertical_name
from tiler.core.units import FOOT, METRE, US_SURVEY_FOOT, Units
from tiler.errors import InputError
from tiler.inputs.common_crs import resolve_common_crs
from tiler.inputs.sources import inspect


def settle(*paths: Path, **config: Any) -> Any:
    return resolve_common_crs([inspect(p) for p in paths], RunConfig(**config))


def with_wkt(text: str) -> Any:
    def edit(cloud: laspy.LasData) -> None:
        record = laspy.VLR("LASF_Projection", 2112, "", text.encode() + b"\0")
        cloud.header.vlrs.append(record)

    return edit


VERTICAL = {
    "another code": ("EPSG:25832+7837", "EPSG:25832+5773"),
    "an older datum": ("EPSG:25832+7837", "EPSG:25832+5783"),
    "another unit too": ("EPSG:25832+7837", "EPSG:25832+8228"),
    "above the ellipsoid": ("EPSG:25832+7837", CRS("EPSG:25832").to_3d().to_wkt()),
}


@pytest.mark.parametrize("name", VERTICAL)
def test_heights_of_two_datums_are_refused_in_any_order(make_cloud: Any, name: str) -> None:
    codes = VERTICAL[name]
    paths = [
        make_cloud(f"{i}.las", n=5, crs=None, edit=with_wkt(CRS(code).to_wkt()))
        for i, code in enumerate(codes)
    ]
    bare = make_cloud("bare.las", n=5, crs="EPSG:25832")
    for order in ([bare, *paths], [paths[1], bare, paths[0]]):
        for units in (None, "m,m"):
            with pytest.raises(InputError, match="its heights refer to ") as caught:
                settle(*order, units=units)
            line = str(caught.value)
            assert all(str(path) in line for path in paths)
            assert "DHHN2016 height (EPSG:7837)" in line
            assert "run them apart, convert the heights, or" in line
    for code, path in zip(codes, paths, strict=True):
        agreed = settle(bare, path, units="m,ft" if code.endswith("8228") else None)
        assert vertical_name(agreed.wkt) == vertical_name(CRS(code).to_wkt())


def test_one_vertical_datum_written_in_several_ways_agrees(make_cloud: Any) -> None:
    crs = CRS("EPSG:25832+5703")
    wkt1 = crs.to_wkt("WKT1_GDAL")
    texts = [crs.to_wkt(), wkt1, crs.to_wkt("WKT1_ESRI")]
    without_code = wkt1.replace(',AUTHORITY["EPSG","5103"]', "")
    without_code = without_code.replace(',AUTHORITY["EPSG","5703"]', "")
    texts.append(without_code.replace("NAVD88 height", "NAVD88 height - Geoid18 (Meters)"))
    texts.append(without_code.replace("Datum 1988", "Datum of 1988"))
    assert len(set(texts)) == len(texts)
    paths = [
        make_cloud(f"{i}.las", n=5, crs=None, edit=with_wkt(text))
        for i, text in enumerate(texts)
    ]
    assert settle(*paths) == settle(*reversed(paths))


def test_given_vertical_crs_is_for_files_without_one(make_cloud: Any) -> None:
    given = "EPSG:25832+7837"
    bare = make_cloud("bare.las", n=5, crs=None)
    flat = make_cloud("flat.las", n=5, crs="EPSG:25832")
    high = make_cloud("high.las", n=5, crs="EPSG:25832+5773")
    agreed = settle(bare, flat, crs=given)
    assert CRS.from_wkt(agreed.wkt) == CRS(given)
    assert not any("is only for" in text for text in agreed.notes)
    with pytest.raises(InputError, match="its heights refer to"):
        settle(bare, flat, high, crs=given)
    agreed = settle(high, crs=given)
    assert CRS.from_wkt(agreed.wkt) == CRS("EPSG:25832+5773")
    (note,) = [text for text in agreed.notes if text.startswith(f"--crs {given} is only for")]
    assert "1 of 1 files have their own, ETRS89 / UTM zone 32N + EGM96 height, which" in note


def test_heights_in_two_units_are_refused(make_cloud: Any) -> None:
    one = make_cloud("a.las", n=5, crs="EPSG:2991+6360")
    other = make_cloud("b.las", n=5, crs="EPSG:2991")
    with pytest.raises(InputError, match="heights are in"):
        settle(one, other)
    with pytest.raises(InputError, match="heights are in"):
        settle(one, other, units="m")
    # Heights of the other file are assumed to be in the horizontal unit.
    assert settle(one, other, units="usft").units.vertical == US_SURVEY_FOOT
    assert settle(one, other, units="m,usft").units.vertical == US_SURVEY_FOOT


@pytest.mark.parametrize("order", [1, -1])
def test_horizontal_unit_alone_does_not_settle_mixed_heights(
    make_cloud: Any, order: int
) -> None:
    feet = make_cloud("a.las", n=5, crs="EPSG:25832+8228")
    metres = make_cloud("b.las", n=5, crs="EPSG:25832+5703")
    paths = [feet, metres][::order]
    for units in (None, "m", "ft"):
        with pytest.raises(InputError, match="give the units of all with --units h,v"):
            settle(*paths, units=units)
    for vertical, wrong, right in (("m", feet, metres), ("ft", metres, feet)):
        agreed = settle(*paths, units=f"m,{vertical}")
        assert agreed.units == Units(METRE, {"m": METRE, "ft": FOOT}[vertical])
        assert vertical_name(agreed.wkt) == vertical_name(settle(right).wkt)
        (note,) = [text for text in agreed.notes if "although" in text]
        assert f"although the CRS of {wrong} has" in note


def test_vertical_crs_of_another_unit_than_the_given_one_is_left_out(make_cloud: Any) -> None:
    high = make_cloud("a.las", n=5, crs="EPSG:25832+7837")
    bare = make_cloud("b.las", n=5, crs=None)
    for path, crs in ((high, None), (bare, "EPSG:25832+7837")):
        for units in ("m", "m,m"):
            agreed = settle(path, crs=crs, units=units)
            assert vertical_name(agreed.wkt) == "DHHN2016 height (EPSG:7837)"
            assert not any("although" in text for text in agreed.notes)
        agreed = settle(path, crs=crs, units="m,ft")
        assert agreed.units == Units(METRE, FOOT)
        assert CRS.from_wkt(agreed.wkt) == CRS("EPSG:25832")
        (note,) = [text for text in agreed.notes if "although" in text]
        assert f"heights are read in feet although the CRS of {path} has metres" in note
