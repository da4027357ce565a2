"""Runs in odd places: long paths, other spellings of paths, names outside the code page, results that are open."""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path

import pytest

from tests.integration.command import command, ended, environment
from tests.invariants import clouds
from tests.invariants.runs import computed, do, output_digests
from tests.scenes.running import IS_WINE
from tests.scenes.windows_paths import junction_or_skip, spelled
from tiler.errors import ProcessingError

pytestmark = pytest.mark.usefixtures("in_this_process")


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return clouds.write(tmp_path_factory.mktemp("in") / "hill.laz", clouds.city(60.0, 1.0))


@pytest.fixture(scope="module")
def plain(cloud: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    out = tmp_path_factory.mktemp("plain") / "out"
    do(cloud, out)
    return output_digests(out)


@pytest.mark.parametrize(
    "place", ["long", "junction", "extended path", "device path", "UNC path"]
)
def test_a_run_in_an_odd_place_gives_the_same(
    place: str, cloud: Path, plain: dict[str, str], tmp_path: Path
) -> None:
    folder = tmp_path
    if place == "long":
        folder = tmp_path / ("a" * 100) / ("b" * 100) / ("c" * 60)
        try:
            folder.mkdir(parents=True)
        except OSError as error:
            pytest.skip(f"no long paths: {error.strerror}")
        if IS_WINE:
            pytest.skip("Wine does not resolve paths of more than 259 characters")
    elif place == "junction":
        folder = tmp_path / "junction"
        (tmp_path / "real").mkdir()
        junction_or_skip(folder, tmp_path / "real")
    else:
        folder = spelled(place, tmp_path)
    source = Path(shutil.copy(cloud, folder / "hill.laz"))
    assert do(source, folder / "out").exit_code == 0
    assert output_digests(folder / "out") == plain
    assert not any(computed(do(source, folder / "out")).values())


def test_a_result_that_is_open_elsewhere_is_replaced_or_kept(
    cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows replaces no open file; in either case, the reader reads on what it opened."""
    monkeypatch.setattr("tiler.io.atomic_files.IN_USE_SECONDS", 0.2)
    out = tmp_path / "out"
    do(cloud, out)
    before = (out / "dtm.tif").read_bytes()
    with (out / "dtm.tif").open("rb") as reader:
        start = reader.read(100)
        if os.name == "nt":
            with pytest.raises(
                ProcessingError, match=r"dtm\.tif: .*another program has it open"
            ):
                do(cloud, out, resolution="2")
        else:
            do(cloud, out, resolution="2")
        assert start + reader.read() == before
    assert not list(out.rglob("*.partial*"))
    assert do(cloud, out, resolution="2").exit_code == 0
    assert (out / "dtm.tif").read_bytes() != before


@pytest.mark.processes
def test_names_outside_the_code_page(
    cloud: Path, plain: dict[str, str], tmp_path: Path
) -> None:
    """A run with Python's text as before UTF-8, whose messages go to a file in the code page of Western Windows."""
    source = Path(shutil.copy(cloud, tmp_path / "Gr\xf6\xdfe_\u70b9.laz"))
    out = tmp_path / "Ausgabe_\xfc_\u70b9"
    legacy = {**environment(), "PYTHONUTF8": "0", "PYTHONIOENCODING": ""}
    if sys.platform != "win32":
        legacy["PYTHONIOENCODING"] = "cp1252:strict"
    options = (
        "--method classic --water none --resolution 1 --tile-size 64 --halo 80 --in-process"
    )
    made = ended(
        command("run", source, "-o", out, *options.split()), env=legacy, encoding="cp1252"
    )
    assert made.returncode == 0, made.stderr
    assert (out / "classified" / source.name).is_file()
    assert json.loads((out / "run.json").read_text("utf-8"))["state"] == "done"
    assert output_digests(out)["dtm.tif"] == plain["dtm.tif"]
