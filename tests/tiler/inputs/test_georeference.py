from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import laspy
import pytest
from pyproj import CRS

from tiler.config import RunConfig
from tiler.core.crs import same_horizontal
from tiler.core.units import FOOT, METRE, US_SURVEY_FOOT, Units
from tiler.errors import ConfigError, InputError
from tiler.inputs.common_crs import resolve_common_crs
from tiler.inputs.sources import SourceInfo, inspect


def settle(*paths: Path, **config: Any) -> Any:
    return resolve_common_crs([inspect(p) for p in paths], RunConfig(**config))


UNITS = {
    "EPSG:25832": Units(METRE, METRE),
    "EPSG:2992": Units(FOOT, FOOT),
    "EPSG:2903": Units(US_SURVEY_FOOT, US_SURVEY_FOOT),
    "EPSG:2991+6360": Units(METRE, US_SURVEY_FOOT),
    "EPSG:2992+5703": Units(FOOT, METRE),
    "EPSG:25832+7837": Units(METRE, METRE),
    "EPSG:2903+8228": Units(US_SURVEY_FOOT, FOOT),
    "EPSG:31467": Units(METRE, METRE),
}


@pytest.mark.parametrize("code", UNITS)
@pytest.mark.parametrize("point_format", [3, 6])
def test_units_of_each_axis_are_exact(make_cloud: Any, code: str, point_format: int) -> None:
    version = "1.4" if point_format > 5 else "1.2"
    agreed = settle(
        make_cloud("u.las", n=5, crs=code, point_format=point_format, version=version)
    )
    assert agreed.units == UNITS[code]
    assert agreed.wkt is not None
    assert ("no vertical CRS" in " ".join(agreed.notes)) == ("+" not in code)


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        ("EPSG:4326", "geographic"),
        ("EPSG:4979", "geographic"),
        ("EPSG:4978", "geocentric"),
        ("EPSG:4326+5773", "geographic"),
    ],
)
def test_degrees_and_geocentric_are_refused(make_cloud: Any, code: str, kind: str) -> None:
    def wkt2(cloud: laspy.LasData) -> None:
        text = CRS.from_user_input(code).to_wkt() + "\0"
        cloud.header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "", text.encode()))

    path = make_cloud("deg.las", n=5, crs=None, edit=wkt2)
    with pytest.raises(InputError, match=f"is {kind}.*reproject") as caught:
        settle(path)
    assert str(path) in str(caught.value)
    with pytest.raises(ConfigError, match=kind):
        settle(make_cloud("none.las", n=5, crs=None), crs=code)


def test_mixed_crs_names_two_files(make_cloud: Any) -> None:
    one, other = make_cloud("a.las", n=5), make_cloud("b.las", n=5, crs="EPSG:25833")
    with pytest.raises(InputError) as caught:
        settle(one, other)
    assert str(one) in str(caught.value)
    assert str(other) in str(caught.value)


def test_the_same_crs_written_in_two_ways_agrees_in_any_order(make_cloud: Any) -> None:
    one = make_cloud("a.las", n=5, crs="EPSG:2154")
    text = CRS.from_epsg(2154).to_wkt("WKT1_ESRI")
    other = make_cloud("b.las", n=5, crs=text)
    assert settle(one, other) == settle(other, one)


def test_names_do_not_make_a_crs() -> None:
    assert same_horizontal(
        CRS.from_epsg(2154), CRS.from_wkt(CRS.from_epsg(2154).to_wkt("WKT1_GDAL"))
    )
    assert not same_horizontal(CRS.from_epsg(2992), CRS.from_epsg(2991))
    assert not same_horizontal(CRS.from_epsg(25832), CRS.from_epsg(32632))


def test_missing_crs_names_the_option(make_cloud: Any) -> None:
    path = make_cloud("no.las", n=5, crs=None)
    with pytest.raises(InputError, match="--crs EPSG"):
        settle(path)
    agreed = settle(path, crs="none")
    assert agreed.wkt is None
    assert agreed.units == Units()
    assert agreed.notes == [
        "the files have no CRS: coordinates are assumed to be in metres (--crs, --units)"
    ]
    given = settle(path, crs="EPSG:2992")
    assert given.units.horizontal == FOOT
    assert CRS.from_wkt(given.wkt).to_epsg() == 2992


def test_given_crs_must_be_that_of_the_files_that_have_one(make_cloud: Any) -> None:
    bare, has = make_cloud("no.las", n=5, crs=None), make_cloud("has.las", n=5)
    assert settle(bare, has, crs="EPSG:25832").wkt is not None
    with pytest.raises(InputError, match=r"no\.las"):
        settle(bare, has, crs="EPSG:25833")
    with pytest.raises(InputError, match="--crs"):
        settle(bare, has, crs="none")


@pytest.mark.parametrize("text", ["EPSG:0", "nonsense", ""])
def test_a_crs_that_cannot_be_parsed_is_refused(make_cloud: Any, text: str) -> None:
    with pytest.raises(ConfigError, match="--crs"):
        settle(make_cloud("no.las", n=5, crs=None), crs=text)


def test_units_override(make_cloud: Any) -> None:
    path = make_cloud("u.las", n=5, crs="EPSG:2992")
    assert settle(path, units="m").units == Units(METRE, METRE)
    assert settle(path, units="ft,m").units == Units(FOOT, METRE)
    assert settle(path, units="usft,ft").units == Units(US_SURVEY_FOOT, FOOT)
    with pytest.raises(ConfigError, match="cubit"):
        settle(path, units="cubit")
    with pytest.raises(ConfigError, match="--units"):
        settle(path, units="m,m,m")


def test_notes_say_which_settings_are_used_and_which_are_not(make_cloud: Any) -> None:
    path = make_cloud("a.las", n=5, crs="EPSG:25832")
    assert not any("--crs" in text for text in settle(path, crs="EPSG:25832").notes)
    for given in ("none", "EPSG:2992"):
        agreed = settle(path, crs=given)
        assert agreed.units == Units()
        begin = f"--crs {given} is only for files without a CRS"
        (note,) = [text for text in agreed.notes if text.startswith(begin)]
        assert (
            "1 of 1 files have their own, ETRS89 / UTM zone 32N, which is used; if it is wrong, write"
            in note
        )
    (note,) = [text for text in settle(path, units="ft").notes if "although" in text]
    assert "x and y are read in feet although their CRS has metres" in note
    assert not any("although" in text for text in settle(path, units="m,ft").notes)


def keys(*entries: tuple[int, int]) -> bytes:
    rows = [(1, 1, 0, len(entries)), *((k, 0, 1, v) for k, v in entries)]
    return b"".join(struct.pack("<4H", *row) for row in rows)


def with_keys(*entries: tuple[int, int], wkt: str | None = None) -> Any:
    def edit(cloud: laspy.LasData) -> None:
        cloud.header.vlrs.append(laspy.VLR("LASF_Projection", 34735, "", keys(*entries)))
        if wkt is not None:
            cloud.header.vlrs.append(
                laspy.VLR("LASF_Projection", 2112, "", wkt.encode() + b"\0")
            )

    return edit


KEYED = {
    "metres": ([(1024, 1), (3072, 25832)], Units(METRE, METRE)),
    "US feet": ([(1024, 1), (3072, 2903), (3076, 9003)], Units(US_SURVEY_FOOT, US_SURVEY_FOOT)),
    "heights in feet": ([(3072, 25832), (4099, 9002)], Units(METRE, FOOT)),
    "vertical CRS": ([(3072, 25832), (4096, 6360)], Units(METRE, US_SURVEY_FOOT)),
    "unit above the datum's": ([(3072, 2903), (4096, 5703), (4099, 9003)], UNITS["EPSG:2903"]),
    "a datum for a CRS": ([(3072, 2903), (4096, 5103), (4099, 9003)], UNITS["EPSG:2903"]),
}


@pytest.mark.parametrize("name", KEYED)
def test_geotiff_keys(make_cloud: Any, name: str) -> None:
    entries, units = KEYED[name]
    assert settle(make_cloud("k.las", n=5, crs=None, edit=with_keys(*entries))).units == units


@pytest.mark.parametrize(("unit", "code"), [(9001, 5703), (9002, 8228), (9003, 6360)])
def test_a_unit_in_the_keys_keeps_the_datum(make_cloud: Any, unit: int, code: int) -> None:
    """EPSG has NAVD88 in metres and in both feet."""
    entries = [(1024, 1), (3072, 26910), (3076, 9001), (4096, 5703), (4099, unit)]
    agreed = settle(make_cloud("k.las", n=5, crs=None, edit=with_keys(*entries)))
    assert [part.to_epsg() for part in CRS.from_wkt(agreed.wkt).sub_crs_list] == [26910, code]


def test_a_unit_that_epsg_has_not_for_the_datum_is_told(make_cloud: Any) -> None:
    entries = [(1024, 1), (3072, 2154), (4096, 5720), (4099, 9002)]
    path = make_cloud("k.las", n=5, crs=None, edit=with_keys(*entries))
    assert settle(path).units == Units(METRE, FOOT)
    assert "NGF-IGN69 height in another unit, for which EPSG has no CRS" in str(
        inspect(path).notes
    )


def test_user_defined_keys_are_noted(make_cloud: Any) -> None:
    path = make_cloud(
        "k.las", n=5, crs=None, edit=with_keys((1024, 1), (3072, 32767), (2048, 4326))
    )
    with pytest.raises(InputError, match=r"only EPSG codes.*--crs"):
        settle(path)


@pytest.mark.parametrize("bit", [False, True])
def test_the_wkt_bit_decides_between_wkt_and_keys(make_cloud: Any, bit: bool) -> None:
    wkt = CRS.from_epsg(25833).to_wkt("WKT1_GDAL")
    edit = with_keys((3072, 25832), wkt=wkt)
    path = make_cloud("two.las", n=5, crs=None, version="1.4", point_format=6, edit=edit)
    data = bytearray(path.read_bytes())
    data[6] = (data[6] | 0x10) if bit else (data[6] & ~0x10)
    path.write_bytes(data)
    assert CRS.from_wkt(settle(path).wkt).to_epsg() == (25833 if bit else 25832)


@pytest.mark.parametrize(
    "text", [b"", b"\0\0\0", b"\xef\xbb\xbf", b"PROJCS[broken", b"\xff\xfe\x00"]
)
def test_unusable_wkt_is_a_missing_crs(make_cloud: Any, text: bytes) -> None:
    def edit(cloud: laspy.LasData) -> None:
        cloud.header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "", text))

    with pytest.raises(InputError, match=r"has no CRS \(.*--crs"):
        settle(make_cloud("w.las", n=5, crs=None, edit=edit))


@pytest.mark.parametrize(
    ("parameters", "is_used"),
    [
        ("+proj=merc +a=6378137 +b=6378137 +nadgrids=@null +to_meter=1/3 +wktext", True),
        ("+proj=utm +zone=32 +nadgrids=/tmp/x.gsb", False),
        ("+proj=utm +zone=32 +nadgrids=C:\\x.gsb", False),
        ("+proj=utm +zone=32 +geoidgrids=https://example.org/x.tif", False),
        ("+init=x:1", False),
    ],
)
def test_a_crs_with_a_file_for_proj_is_a_missing_crs(
    make_cloud: Any, parameters: str, is_used: bool
) -> None:
    plain = CRS.from_epsg(25832).to_wkt("WKT1_GDAL")
    named = plain.replace(',AUTHORITY["EPSG","25832"]]', f',EXTENSION["PROJ4","{parameters}"]]')
    assert parameters in named
    info = inspect(make_cloud("e.las", n=5, crs=None, edit=with_wkt(named)))
    assert (info.georeference.kind != "missing") == is_used


def test_a_path_is_not_a_crs(make_cloud: Any) -> None:
    for path in ("/tmp/x.prj", "file:/tmp/x", "+init=/tmp/x:1"):
        info = inspect(make_cloud("p.las", n=5, crs=None, edit=with_wkt(path)))
        assert info.georeference.kind == "missing"


def with_wkt(text: str) -> Any:
    def edit(cloud: laspy.LasData) -> None:
        cloud.header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "", text.encode()))

    return edit


def test_local_crs_with_feet(make_cloud: Any) -> None:
    text = 'LOCAL_CS["site",UNIT["foot",0.3048],AXIS["x",EAST],AXIS["y",NORTH]]'
    agreed = settle(make_cloud("l.las", n=5, crs=text))
    assert agreed.units == Units(FOOT, FOOT)


def test_projections_of_pyproj_and_rasterio_live_together(make_cloud: Any) -> None:
    rasterio_crs = pytest.importorskip("rasterio.crs")
    wkt = settle(make_cloud("a.las", n=5, crs="EPSG:2154")).wkt
    assert rasterio_crs.CRS.from_wkt(wkt).to_epsg() == 2154
    assert CRS.from_epsg(2903).axis_info[0].unit_name == "US survey foot"
    assert rasterio_crs.CRS.from_epsg(2903).linear_units_factor[1] == pytest.approx(1200 / 3937)


def test_digest_and_size_are_in_the_description(make_cloud: Any) -> None:
    info: SourceInfo = inspect(make_cloud("a.las", n=5))
    described = info.to_json()
    assert described["points"] == 5
    assert described["size"] == info.path.stat().st_size
