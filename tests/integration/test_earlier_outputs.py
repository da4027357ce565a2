"""What an earlier run left in OUT is current or put aside, never old and in its place."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path

import pytest
import shapely

from tests.invariants import clouds
from tests.invariants.runs import do
from tests.scenes.drawings import draw
from tests.scenes.journals import n_features, opened_in_gis
from tiler.apps.clean import clean
from tiler.errors import ConfigError
from tiler.io.result_folder import foreign_files
from tiler.report.html import write_report_at

BOTH = "dtm,slope"
PLAIN = {
    "dtm.tif", "outline.gpkg", "review.gpkg", "classified/hill.laz", "classified.vpc", "stac.json",
}  # fmt: skip
"""What a run makes that asks for nothing else."""


def rasters(out: Path) -> set[str]:
    return {
        path.relative_to(out).as_posix()
        for path in out.rglob("*.tif")
        if "store.zarr" not in path.parts
    }


def test_a_product_of_the_same_settings_stays(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    do(cloud, out, products=BOTH)
    before = (out / "slope.tif").read_bytes()
    for _ in range(2):
        result = do(cloud, out)
        assert set(result.summary["outputs"]) == {"slope.tif", *PLAIN}
        assert (out / "slope.tif").read_bytes() == before
    do(cloud, out, products="hillshade")
    assert rasters(out) == {"dtm.tif", "slope.tif", "hillshade.tif"}


def test_a_product_of_other_settings_is_put_aside_and_told(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    do(cloud, out, products=BOTH)
    before = (out / "slope.tif").read_bytes()
    result = do(cloud, out, parameters={"iteration_distance": "1.2"}, resolution="2")
    assert rasters(out) == {"dtm.tif", "outdated/slope.tif"}
    assert (out / "outdated" / "slope.tif").read_bytes() == before
    assert set(result.summary["outputs"]) == PLAIN
    (note,) = [text for text in result.summary["notes"] if "moved" in text]
    assert note.startswith("slope.tif: written by an earlier run with other settings or inputs")
    assert result.summary["earlier_outputs"] == {}
    again = do(cloud, out, products=BOTH, resolution="2", overwrite=True)
    assert "slope.tif" in again.summary["outputs"]
    assert not [text for text in again.summary["notes"] if "moved" in text]


def test_a_url_of_a_folder_on_this_machine_is_that_folder(
    cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The current folder has the one whose name is the last part of the URL, and a run locks both."""
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "out"
    assert do(cloud, out.as_uri(), products=BOTH).exit_code == 0
    before = (out / "slope.tif").read_bytes()
    assert (out / "classified" / "hill.laz").is_file()
    how = {"parameters": {"iteration_distance": "1.2"}, "resolution": "2"}
    result = do(cloud, out.as_uri(), **how)
    assert result.exit_code == 0
    assert rasters(out) == {"dtm.tif", "outdated/slope.tif"}
    assert (out / "outdated" / "slope.tif").read_bytes() == before
    assert result.summary["products_at"] is None
    assert do(cloud, out, **how).did_nothing
    run_file = out / "run.json"
    of_older_version = json.loads(run_file.read_text("utf-8")) | {"products_at": out.as_uri()}
    run_file.write_text(json.dumps(of_older_version), "utf-8")
    assert foreign_files(out, str(out), ["dtm.tif"]) == []
    assert Path(write_report_at(out.as_uri())) == out / "report.html"
    assert clean(out.as_uri()).store_bytes > 0
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert do(cloud, out.as_uri(), **how).did_nothing
    assert not list(Path().iterdir())


def test_files_give_way_to_sheets_and_labels_to_the_inputs_own(
    cloud: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    do(cloud, out)
    do(cloud, out, sheets="40", method="keep", ground_classes="1")
    assert not (out / "classified").exists()
    assert (out / "outdated" / "classified" / "hill.laz").is_file()
    assert (out / "outdated" / "dtm.tif").is_file()
    assert (out / "dtm.vrt").is_file()
    do(cloud, out)
    assert (out / "dtm.tif").is_file()
    assert not (out / "dtm").exists()
    assert list((out / "outdated" / "dtm").glob("dtm_*.tif"))


def test_what_an_interrupted_export_left_is_not_taken_for_current(
    cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    do(cloud, out, products=BOTH)

    def killed(*arguments: object) -> bool:
        raise KeyboardInterrupt

    monkeypatch.setattr("tiler.export.stage._write", killed)
    with pytest.raises(KeyboardInterrupt):
        do(cloud, out, products=BOTH, max_edge="3")
    monkeypatch.undo()
    found = json.loads((out / "run.json").read_text())
    assert "slope.tif" in found["earlier_outputs"]
    do(cloud, out, max_edge="3")
    assert rasters(out) == {"dtm.tif", "outdated/slope.tif"}


def test_an_early_stage_says_whose_files_these_are(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    do(cloud, out)
    assert not do(cloud, out, until="filter").summary["notes"]
    found = do(cloud, out, until="filter", parameters={"iteration_distance": "1.2"}).summary
    assert found["notes"][-1].startswith(
        f"files in {out} are those of an earlier run until `tiler export`"
    )
    assert "dtm.tif" in found["earlier_outputs"]


def test_a_list_that_leads_elsewhere_moves_nothing(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    do(cloud, out)
    precious = tmp_path / "precious.tif"
    precious.write_bytes(b"mine")
    found = json.loads((out / "run.json").read_text())
    found["outputs"] |= {"../precious.tif": 4, str(precious): 4}
    (out / "run.json").write_text(json.dumps(found))
    do(cloud, out)
    assert precious.read_bytes() == b"mine"


def test_a_folder_that_is_input_and_out_reads_only_what_the_user_put_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a", "b"):
        clouds.write(tmp_path / "site" / f"{name}.laz", clouds.city(60.0, 1.0))
    monkeypatch.chdir(tmp_path / "site")
    do(Path("."), Path("."))
    Path("b.laz").unlink()
    alone = do(Path("."), Path("."))
    assert [entry["path"] for entry in alone.summary["inputs"]] == ["a.laz"]
    assert Path("outdated/classified/b.laz").is_file()
    again = do(Path("."), Path("."))
    assert again.did_nothing
    parent = do(tmp_path, tmp_path / "whole")
    assert [Path(entry["path"]).name for entry in parent.summary["inputs"]] == ["a.laz"]


@pytest.mark.parametrize("products", ["dtm,contours", "dtm"])
def test_edits_in_a_geopackage_that_is_open_are_never_lost(
    products: str, cloud: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    do(cloud, out, products="dtm,contours")
    contours, made = out / "contours.gpkg", n_features(out / "contours.gpkg")
    with closing(opened_in_gis(contours)) as database:
        before = (out / "run.json").read_bytes(), contours.read_bytes()
        with pytest.raises(ConfigError, match=r"contours\.gpkg-wal: its GeoPackage is open"):
            do(cloud, out, products=products, resolution="2", overwrite=True, force=True)
        assert ((out / "run.json").read_bytes(), contours.read_bytes()) == before
        assert database.execute("SELECT count(*) FROM contours").fetchone() == (made + 1,)
    assert do(cloud, out, products=products, resolution="2").exit_code == 0
    assert n_features(out / "outdated" / "contours.gpkg") == made + 1


@pytest.mark.parametrize(("sheets", "raster"), [({}, "dtm.tif"), ({"sheets": "40"}, "dtm.vrt")])
def test_sidecars_stay_with_the_same_bytes_and_go_with_others(
    sheets: dict[str, str], raster: str, cloud: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    do(cloud, out, **sheets)
    overviews, style = out / f"{raster}.ovr", out / f"{raster.split('.')[0]}.qml"
    overviews.write_text("overviews")
    style.write_text("style")
    (out / raster).unlink()
    do(cloud, out, **sheets, overwrite=True)
    assert overviews.is_file()
    mosaic = (out / raster).read_bytes()
    # The edit changes pixels but no extent, so a VRT keeps its bytes.
    edits = draw(
        tmp_path / "e.json", [(shapely.box(20, 20, 30, 30), {"action": "flat", "z": 9})]
    )
    do(cloud, out, **sheets, edits=edits)
    assert ((out / raster).read_bytes() == mosaic) == bool(sheets)
    assert not overviews.exists()
    assert (out / "outdated" / overviews.name).read_text() == "overviews"
    assert style.is_file()


def test_sidecars_go_after_an_interruption(
    cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run that replaced the raster was killed before it moved them."""
    out = tmp_path / "out"
    do(cloud, out)
    (out / "dtm.tif.ovr").write_text("overviews")

    def killed(*arguments: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("tiler.export.stage.archive_sidecars", killed)
        with pytest.raises(KeyboardInterrupt):
            do(cloud, out, resolution="2", overwrite=True)
    assert (out / "dtm.tif.ovr").is_file()
    do(cloud, out, resolution="2")
    assert (out / "outdated" / "dtm.tif.ovr").is_file()
