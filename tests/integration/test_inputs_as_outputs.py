"""No command writes over what it reads, or makes a folder its own that holds it."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

import tiler
from cli.main import main
from tests.invariants import clouds
from tests.invariants.runs import do
from tests.scenes.finished import Finished
from tests.scenes.folders import content
from tiler.errors import ConfigError

pytestmark = [
    pytest.mark.usefixtures("in_this_process"),
    pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning"),
]


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    return clouds.write(tmp_path / "in" / "hill.laz", clouds.city(60.0, 1.0))


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line of a command that ends with code 2."""
    code = main([str(a) for a in arguments])
    line = capsys.readouterr().err.strip()
    assert code == 2, line
    assert line.count("\n") == 0
    return line


@pytest.mark.parametrize(
    "store", ["out", ".", "in", "in/hill.laz", "link", "out/classified", "out/dtm"]
)
def test_a_store_is_no_place_of_inputs_or_results(
    store: str, cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to("in")
    (tmp_path / "out").mkdir()
    before = content(tmp_path)
    with pytest.raises(ConfigError, match="(is the same as|contains) .*; give another folder"):
        do(Path("in/hill.laz"), Path("out"), store=store, clean_store=True, overwrite=True)
    assert content(tmp_path) == before


def test_notes_in_a_store_survive_it(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    do(cloud, out)
    note = out / "store.zarr" / "points" / "notes.txt"
    note.write_text("mine")
    assert do(cloud, out, overwrite=True).exit_code == 0
    assert note.read_text() == "mine"
    assert do(cloud, out, clean_store=True).exit_code == 0
    assert [p for p in (out / "store.zarr").rglob("*") if p.is_file()] == [note]


def test_a_store_that_is_a_link_is_used_and_emptied(cloud: Path, tmp_path: Path) -> None:
    out, disk = tmp_path / "out", tmp_path / "disk"
    out.mkdir()
    disk.mkdir()
    (out / "store.zarr").symlink_to(disk)
    do(cloud, out)
    assert (disk / "zarr.json").is_file()
    assert do(cloud, out, overwrite=True).exit_code == 0
    assert do(cloud, out, clean_store=True).exit_code == 0
    assert not list(disk.iterdir())
    assert do(cloud, out).exit_code == 0


@pytest.mark.parametrize("link", ["classified", "outdated"])
def test_a_folder_of_results_that_leads_to_the_inputs(
    link: str, cloud: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / link).symlink_to(cloud.parent)
    with pytest.raises(ConfigError, match=re.escape(f"-o {out}/{link}: contains {cloud}")):
        do(cloud, out, force=True)


def test_a_result_that_is_a_link_to_an_input(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / "classified").mkdir(parents=True)
    (out / "classified" / "hill.laz").symlink_to(cloud)
    before = cloud.read_bytes()
    with pytest.raises(ConfigError, match=r"classified/hill.laz is an input"):
        do(cloud, out, force=True)
    assert cloud.read_bytes() == before


def test_preview_and_classify(
    cloud: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = content(tmp_path)
    assert "use .png" in refused(capsys, "preview", cloud, "-o", cloud)
    picture = tmp_path / "in" / "link.png"
    picture.symlink_to(cloud)
    assert "is an input" in refused(capsys, "preview", cloud, "-o", picture)
    assert "use .laz" in refused(capsys, "classify", cloud, tmp_path / "b.tif")
    (tmp_path / "b.laz").symlink_to(cloud)
    assert "is an input" in refused(capsys, "classify", cloud, tmp_path / "b.laz")
    assert content(tmp_path).items() >= before.items()
    assert cloud.read_bytes() == before["in/hill.laz"]


def raster(path: Path) -> Path:
    path.parent.mkdir(exist_ok=True)
    profile = {
        "height": 4,
        "width": 4,
        "count": 1,
        "dtype": "float32",
        "transform": Affine(1, 0, 0, 0, -1, 4),
    }
    with rasterio.open(path, "w", driver="GTiff", **profile) as target:
        target.write(np.ones((1, 4, 4), np.float32))
    return path


def test_evaluate_and_check(
    cloud: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    true, mine = raster(tmp_path / "true.tif"), raster(tmp_path / "hill.tif")
    vrt = tmp_path / "mine.vrt"
    vrt.write_text(
        '<VRTDataset rasterXSize="4" rasterYSize="4"><GeoTransform>0, 1, 0, 4, 0, -1</GeoTransform><VRTRasterBand '
        'dataType="Float32" band="1"><SimpleSource><SourceFilename relativeToVRT="1">hill.tif</SourceFilename>'
        "<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    before = content(tmp_path)
    pair = ("evaluate", "--dtm", vrt, "--true-dtm", true)
    for difference in (true, mine, tmp_path / "." / "true.tif"):
        assert f"--difference {difference} is an input" in refused(
            capsys, *pair, "--difference", difference
        )
    assert "use .tif" in refused(capsys, *pair, "--difference", cloud)
    scored = ("evaluate", cloud, "--reference", cloud, "--dtm", vrt, "--true-dtm", true)
    assert "hill.tif is an input" in refused(capsys, *scored, "--maps", tmp_path)
    (tmp_path / "map.svg").symlink_to(true)
    points = tmp_path / "points.csv"
    points.write_text("1,1,1\n")
    check = refused(capsys, "check", true, "--points", points, "--figures", tmp_path)
    assert "map.svg is an input" in check
    assert content(tmp_path).items() >= before.items()


def test_what_commands_name_themselves_replaces_no_other_file(
    cloud: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photo, drawing = raster(tmp_path / "maps" / "hill.tif"), tmp_path / "maps" / "map.svg"
    drawing.write_text("<svg/>")
    scored = ("evaluate", cloud, "--reference", cloud, "--maps", tmp_path / "maps")
    assert f"{photo}: already exists and is not a map of errors" in refused(capsys, *scored)
    points = tmp_path / "points.csv"
    points.write_text("2,2,1\n3,3,1\n")
    checked = ("check", photo, "--points", points, "--figures", tmp_path / "maps")
    assert f"{drawing}: already exists and is not a drawing" in refused(capsys, *checked)
    for path in (photo, drawing):
        path.rename(tmp_path / path.name)
    checked = ("check", tmp_path / "hill.tif", *checked[2:])
    for _ in range(2):
        assert main([str(a) for a in scored]) == 0
        assert main([str(a) for a in checked]) == 0
    assert len(list((tmp_path / "maps").iterdir())) == 4
    capsys.readouterr()
    terrain = tmp_path / "scene_dtm.tif"
    terrain.write_text("mine")
    assert f"{terrain}: already exists" in refused(
        capsys, "simulate", tmp_path / "scene.laz", "--size", 60
    )
    assert terrain.read_text() == "mine"


@pytest.mark.parametrize("name", ["input/city_sw.laz", "input/truth/dtm.tif", "evaluate.json"])
def test_a_demo_replaces_nothing(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / name).write_text("mine")
    assert f"{Path(name)}: already exists" in refused(capsys, "demo", "-o", tmp_path)
    assert [p.read_text() for p in tmp_path.rglob("*") if p.is_file()] == ["mine"]


def test_a_difference_takes_no_file_beside_it_along(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """GDAL removes the world file, masks and metadata of what it writes anew."""
    true, target = raster(tmp_path / "true.tif"), raster(tmp_path / "difference.tif")
    world = target.with_suffix(".tfw")
    world.write_text("1\n0\n0\n-1\n0.5\n3.5\n")
    arguments = ["evaluate", "--dtm", true, "--true-dtm", true, "--difference", target]
    assert main([str(a) for a in arguments]) == 0
    assert world.is_file()
    with rasterio.open(target) as found:
        assert not found.read().any()
    target.unlink()
    target.mkdir()
    assert main([str(a) for a in arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "is a folder; give a file" in error
    assert not list(tmp_path.glob(".tiler-*"))


def test_a_result_of_the_run_is_no_target_of_check(
    tmp_path: Path, finished_run: Finished
) -> None:
    out = tmp_path / "out"
    shutil.copytree(finished_run[0], out)
    terrain = out / "dtm.tif"
    for name in ("dtm.tif", "classified.vpc", "outline.gpkg"):
        before = (out / name).read_bytes()
        with pytest.raises(ConfigError, match="--difference"):
            tiler.check(terrain, against=terrain, difference=out / name)
        assert (out / name).read_bytes() == before
