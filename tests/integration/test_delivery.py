"""Content of a delivery next to the terrain: names of files, index of sheets, names of classes, datum of heights."""

from __future__ import annotations

import json
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

import laspy
import numpy as np
import pyogrio
import pyproj
import pytest
import rasterio
import rasterio.shutil

from cli.summary import summary_lines
from tests.invariants import clouds
from tests.invariants.runs import do
from tiler.apps.check import terrain_in
from tiler.apps.evaluate import raster_beside
from tiler.core.products import MASK_VALUES
from tiler.errors import ConfigError


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return clouds.write(tmp_path_factory.mktemp("cloud") / "town.laz", clouds.city(60.0, 1.0))


def categories(path: Path) -> list[str | None]:
    """Names of the classes of a raster, as GDAL reads them."""
    copy = path.with_name("copy.vrt")
    rasterio.shutil.copy(path, copy, driver="VRT")
    return [node.text for node in ElementTree.parse(copy).iter("Category")]


def test_sheets_have_the_names_of_the_template_and_an_index(
    cloud: Path, tmp_path: Path
) -> None:
    changes = {"products": "dtm,mask", "sheets": "40", "crs": "EPSG:32632+5783"}
    do(cloud, tmp_path, sheet_name="{x_km:.2f}-{y_km:.2f}_{name}", **changes)
    files = sorted(p.relative_to(tmp_path).as_posix() for p in tmp_path.glob("dtm/*.tif"))
    assert files
    meta, _, shapes, columns = pyogrio.raw.read(tmp_path / "sheets.gpkg", layer="dtm")
    found = dict(zip(meta["fields"], columns, strict=True))
    assert sorted(found["location"]) == files
    for i, path in enumerate(found["location"]):
        with rasterio.open(tmp_path / path) as raster:
            values = raster.read(1, masked=True)
            assert tuple(found[n][i] for n in ("west", "south", "east", "north")) == tuple(
                raster.bounds
            )
            x, y = raster.bounds.left / 1000, raster.bounds.bottom / 1000
            assert Path(path).name == f"{x:.2f}-{y:.2f}_dtm.tif"
            assert found["void_percent"][i] == pytest.approx(
                100 * np.ma.getmaskarray(values).mean()
            )
            assert (found["min"][i], found["max"][i]) == (values.min(), values.max())
            assert raster.tags()["VERTICAL_DATUM"] == "DHHN92 height (EPSG:5783)"
            assert pyproj.CRS(raster.crs.to_wkt()).sub_crs_list[1].to_epsg() == 5783
    assert categories(tmp_path / "mask.vrt") == list(MASK_VALUES.values())
    assert do(cloud, tmp_path, sheet_name="{x_km:.2f}-{y_km:.2f}_{name}", **changes).did_nothing
    do(cloud, tmp_path, **changes)
    assert not [p for p in tmp_path.glob("dtm/*.tif") if "-" in p.name]


@pytest.mark.parametrize(
    ("template", "begin"),
    [
        ("Blatt é {x} {y}", {"dtm": "Blatt é ", "mask": "Blatt é "}),
        ("{name} {x}_{y}", {"dtm": "MNT ", "mask": "mask "}),
    ],
)
def test_sheets_of_several_products_may_have_any_name(
    cloud: Path, tmp_path: Path, template: str, begin: dict[str, str]
) -> None:
    """Names without a product, with blanks and accents, and with another name of a product."""
    how = {"products": "dtm,mask", "sheets": "40", "sheet_name": template}
    do(cloud, tmp_path, product_name="dtm=MNT", **how)
    corners = {path.name.split(" ", 1)[-1] for path in tmp_path.glob("stac/*.json")}
    assert len(corners) > 1
    for product, start in begin.items():
        files = sorted(path.name for path in (tmp_path / product).iterdir())
        assert len(files) == len(corners)
        assert all(name.startswith(start) for name in files)
        _, _, _, (locations,) = pyogrio.raw.read(
            tmp_path / "sheets.gpkg", layer=product, columns=["location"], read_geometry=False
        )
        assert sorted(locations) == [f"{product}/{name}" for name in files]
        with rasterio.open(tmp_path / f"{product}.vrt") as mosaic:
            assert {Path(path).name for path in mosaic.files[1:]} == set(files)
    item = json.loads(min(tmp_path.glob("stac/*.json")).read_text())
    for asset in item["assets"].values():
        assert (tmp_path / "stac" / unquote(asset["href"])).is_file()
    assert do(cloud, tmp_path, product_name="dtm=MNT", **how).did_nothing
    (tmp_path / "mask" / files[0]).unlink()
    assert not do(cloud, tmp_path, product_name="dtm=MNT", **how).did_nothing
    assert (tmp_path / "mask" / files[0]).is_file()


def test_rasters_have_no_vertical_crs_of_another_unit_than_their_heights(
    cloud: Path, tmp_path: Path
) -> None:
    do(cloud, tmp_path, crs="EPSG:32632+5783", units="m,ft")
    with rasterio.open(tmp_path / "dtm.tif") as raster:
        assert raster.units == ("foot",)
        assert pyproj.CRS(raster.crs.to_wkt()).to_epsg() == 32632
        assert "VERTICAL_DATUM" not in raster.tags()


@pytest.mark.parametrize(
    ("changes", "raster"), [({}, "dtm.tif"), ({"sheets": "40"}, "dtm.vrt")]
)
def test_ellipsoidal_heights(
    changes: dict[str, str], raster: str, cloud: Path, tmp_path: Path
) -> None:
    """GeoTIFF has no projected CRS with three axes, so the raster has the horizontal one, and a tag for the heights."""
    given = laspy.read(cloud)
    crs = pyproj.CRS("EPSG:32632").to_3d().to_wkt()
    given.header.vlrs[:] = [laspy.VLR("LASF_Projection", 2112, "", crs.encode() + b"\0")]
    given.write(tmp_path / "a.laz")
    out = tmp_path / "out"
    do(tmp_path / "a.laz", out, **changes)
    with rasterio.open(out / raster) as opened:
        assert opened.crs.to_epsg() == 32632
        assert opened.tags()["VERTICAL_DATUM"] == "ellipsoidal height (WGS 84)"
    assert not list(out.rglob("*.aux.xml"))


@pytest.mark.parametrize("crs", [None, "EPSG:32632", "EPSG:32632+5783"])
def test_classified_clouds_have_the_heights_of_the_option(
    crs: str | None, cloud: Path, tmp_path: Path
) -> None:
    run = do(cloud, tmp_path, crs=crs)
    before, after = (
        laspy.read(path).header for path in (cloud, tmp_path / "classified" / cloud.name)
    )
    told = [note for note in run.summary["notes"] if note.startswith("CRS of the run written")]
    if crs is None or "+" not in crs:
        assert [v.record_data_bytes() for v in after.vlrs] == [
            v.record_data_bytes() for v in before.vlrs
        ]
        assert not told
    else:
        assert [part.to_epsg() for part in after.parse_crs().sub_crs_list] == [32632, 5783]
        assert told


def test_classes_of_the_mask_have_names_and_colours(cloud: Path, tmp_path: Path) -> None:
    do(cloud, tmp_path, products="dtm,mask")
    assert categories(tmp_path / "mask.tif") == list(MASK_VALUES.values())
    with rasterio.open(tmp_path / "mask.tif") as raster:
        assert raster.colormap(1)[1] == (90, 150, 90, 255)


def test_rasters_in_one_file_have_other_names_that_every_reader_finds(
    cloud: Path, tmp_path: Path
) -> None:
    """Legend, catalogue, summary and check follow the name. The file of the earlier name is archived."""
    how = {"products": "dtm,mask,sigma", "crs": "EPSG:32632"}
    do(cloud, tmp_path, **how)
    (tmp_path / "mask.tif.aux.xml").stat()
    heights = (tmp_path / "dtm.tif").read_bytes()
    how["product_name"] = "dtm=MNT,mask=Quelle é"
    done = do(cloud, tmp_path, **how)
    names = {path.name for path in tmp_path.glob("*.tif*")}
    assert names == {"MNT.tif", "Quelle é.tif", "Quelle é.tif.aux.xml", "sigma.tif"}
    assert names < done.summary["outputs"].keys()
    assert (tmp_path / "MNT.tif").read_bytes() == heights
    archived = {path.name for path in (tmp_path / "outdated").iterdir()}
    assert archived == {"dtm.tif", "mask.tif", "mask.tif.aux.xml"}
    assert categories(tmp_path / "Quelle é.tif")[2] == MASK_VALUES[2]
    assets = json.loads((tmp_path / "stac.json").read_text("utf-8"))["assets"]
    assert assets["mask"]["href"] == "./Quelle%20%C3%A9.tif"
    assert terrain_in(str(tmp_path)) == str(tmp_path / "MNT.tif")
    assert raster_beside(tmp_path / "MNT.tif", "sigma") == tmp_path / "sigma.tif"
    assert f"DTM         {tmp_path / 'MNT.tif'}, " in "\n".join(
        summary_lines(done.summary, str(tmp_path))
    )
    assert "data:image" in done._repr_html_()
    assert do(cloud, tmp_path, **how).did_nothing
    (tmp_path / "MNT.tif").unlink()
    do(cloud, tmp_path, **how)
    assert (tmp_path / "MNT.tif").read_bytes() == heights
    do(cloud, tmp_path, **how | {"product_name": None})
    assert (tmp_path / "dtm.tif").read_bytes() == heights
    assert not (tmp_path / "MNT.tif").exists()


@pytest.mark.parametrize("name", ["report", "Stac", "dsm", "contours"])
def test_a_raster_with_the_name_of_another_result_is_refused(
    name: str, cloud: Path, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=f"'{name}' is the name of another result; give dtm"):
        do(cloud, tmp_path, product_name=f"dtm={name},dsm=other")
    assert not list(tmp_path.iterdir())
