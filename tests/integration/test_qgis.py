"""The plugin within QGIS, as Debian's package has it: ``qgis_process``, and a session with a project."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import rasterio

from tests.integration.command import command, ended, environment, tiler
from tests.invariants import clouds
from tests.invariants.runs import output_digests
from tiler.core.edits import ACTIONS
from tiler.core.products import MASK_VALUES
from tiler.io.cloud_formats import FORMAT_NAMES

# Debian's `qgis_process` is a script that calls this one with an option that it does not know.
QGIS_PROCESS = shutil.which("qgis_process.bin") or shutil.which("qgis_process")
PYTHON = "/usr/bin/python3"
SESSION = Path(__file__).with_name("qgis_session.py")
OPTIONS = {
    "METHOD": "classic",
    "WORKERS": 1,
    "TILE_SIZE": "64",
    "HALO": "80",
    "RESOLUTION": "1",
}
CALL = (
    "--method",
    "classic",
    "--workers",
    1,
    "--tile-size",
    64,
    "--halo",
    80,
    "--resolution",
    1,
)
STOPPED_AT = "grid: terrain"
MULTIPLY = 13  # of the modes of QPainter

pytestmark = [
    pytest.mark.processes,
    pytest.mark.slow,
    pytest.mark.skipif(QGIS_PROCESS is None, reason="no QGIS here (apt-get install qgis)"),
]


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return clouds.write(tmp_path_factory.mktemp("cloud") / "city.laz", clouds.city(150.0, 1.0))


@pytest.fixture(scope="module")
def by_command(cloud: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command line makes of the cloud."""
    out = tmp_path_factory.mktemp("command") / "out"
    assert tiler("run", cloud, "-o", out, *CALL, "--products", "dtm,mask").returncode == 0
    return out


@pytest.fixture(scope="module")
def profile(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Variables for a QGIS of its own, in which the plugin is installed and switched on."""
    home = tmp_path_factory.mktemp("qgis")
    # QGIS takes the Python of an activated environment for its own: it gets the system's
    # programs alone.
    own = {
        "QGIS_CUSTOM_CONFIG_PATH": str(home),
        "QT_QPA_PLATFORM": "offscreen",
        "PATH": os.defpath,
    }
    variables = {**os.environ, **own}
    known = {**environment(), "QGIS_CUSTOM_CONFIG_PATH": str(home)}
    call = command("qgis", "install")
    assert_done(ended(call, env=known))
    assert_done(qgis(variables, "plugins", "enable", "tiler_qgis"))
    return variables


def qgis(variables: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    return ended([QGIS_PROCESS, *arguments], env=variables)


def assert_done(done: subprocess.CompletedProcess[str]) -> None:
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"


def run(
    variables: dict[str, str], name: str, **parameters: object
) -> subprocess.CompletedProcess[str]:
    return qgis(
        variables,
        "run",
        f"tiler:{name}",
        "--",
        *(f"{n}={value}" for n, value in parameters.items()),
    )


def test_a_run_gives_the_bytes_of_the_command(
    profile: dict[str, str], cloud: Path, by_command: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    done = run(profile, "run", INPUT=cloud, OUTPUT=out, PRODUCTS="dtm,mask", **OPTIONS)
    assert_done(done)
    assert output_digests(out) == output_digests(by_command)
    assert f"DTM:\t{out}/dtm.tif" in done.stdout
    assert "EXIT_CODE:\t0" in done.stdout


def test_an_error_is_one_line_and_no_success(
    profile: dict[str, str], cloud: Path, tmp_path: Path
) -> None:
    done = run(profile, "run", INPUT=tmp_path / "none.laz", OUTPUT=tmp_path / "out")
    assert done.returncode != 0
    line = f"{tmp_path}/none.laz: no such file or folder; give {FORMAT_NAMES} files, folders, globs or .vpc files"
    assert f"ERROR:\t{line}\n" in done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    assert "Results" not in done.stdout


def test_classify_check_and_preview(
    profile: dict[str, str], cloud: Path, by_command: Path, tmp_path: Path
) -> None:
    target, points = tmp_path / "classified.laz", tmp_path / "points.csv"
    assert_done(
        run(profile, "classify", INPUT=cloud, OUTPUT=target, METHOD="classic", WORKERS=1)
    )
    plain = tmp_path / "plain.laz"
    assert (
        tiler("classify", cloud, plain, "--method", "classic", "--workers", 1).returncode == 0
    )
    assert target.read_bytes() == plain.read_bytes()
    points.write_text("x,y,z\n500050,5400050,0\n")
    checked = run(
        profile, "check", INPUT=by_command / "dtm.tif", POINTS=points, REQUIRE="rmse=0.001"
    )
    assert checked.returncode != 0
    assert "NOT met" in checked.stderr
    picture = tmp_path / "preview.png"
    assert_done(
        run(
            profile,
            "preview",
            INPUT=cloud,
            OUTPUT=picture,
            METHOD="classic",
            WINDOWS=1,
            SIZE="40",
        )
    )
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_session(
    profile: dict[str, str], cloud: Path, by_command: Path, tmp_path: Path
) -> None:
    """Stopped and started again, layers in the project, corrections drawn there and applied."""
    out, given, edits, told = (tmp_path / name for name in ("out", "given", "edits", "told"))
    wanted = {"INPUT": [str(cloud)], "OUTPUT": str(out), "PRODUCTS": "dtm,mask", "LOAD": True}
    given.write_text(json.dumps(OPTIONS | wanted))
    with rasterio.open(by_command / "dtm.tif") as terrain:
        x, y = terrain.bounds.left, terrain.bounds.bottom
    edits.write_text(json.dumps([["flat", 200.0, [x + 40, y + 40, x + 60, y + 60]]]))
    plugins = Path(profile["QGIS_CUSTOM_CONFIG_PATH"]) / "profiles/default/python/plugins"
    done = ended([PYTHON, SESSION, plugins, given, edits, told, STOPPED_AT], env=profile)
    assert told.exists(), f"{done.stdout}\n{done.stderr}"
    found: dict[str, Any] = json.loads(told.read_text())
    assert found["stopped"]["titles"][-1] == STOPPED_AT
    assert found["stopped"]["results"] == {}
    assert found["layers_then"] == [], "what was stopped adds nothing to the project"
    assert found["resumed"]["ok"], found["resumed"]["errors"]
    assert output_digests(tmp_path / "then") == output_digests(by_command)
    names = [layer["name"] for layer in found["layers"]]
    assert names == [
        "edits",
        "places to review",
        "outline of the survey",
        "hillshade",
        "source of heights",
        "terrain",
    ]
    edits_layer, review, _, shade, mask, heights = found["layers"]
    assert {layer["group"] for layer in found["layers"]} == {"out"}
    assert edits_layer["widget"] == "ValueMap"
    assert review["widget"] == "ValueMap"  # from the style in the file
    assert [next(iter(entry.values())) for entry in edits_layer["list"]] == list(ACTIONS)
    assert (shade["renderer"], shade["blend"]) == ("hillshade", MULTIPLY)
    assert (heights["renderer"], heights["shown"]) == ("singlebandpseudocolor", True)
    assert (mask["renderer"], mask["shown"]) == ("paletted", False)
    assert set(MASK_VALUES.values()) <= set(mask["legend"])
    assert not found["unsaved"]["ok"]
    assert "edits: has unsaved changes" in found["unsaved"]["errors"][0]
    assert found["edited"]["ok"], found["edited"]["errors"]
    assert [layer["name"] for layer in found["layers_again"]] == names, (
        "they are read again, not added twice"
    )
    with rasterio.open(out / "dtm.tif") as terrain:
        assert next(terrain.sample([(x + 50, y + 50)])) == 200.0
    assert [2, "Ground"] in found["classes"]
    by_hand = tmp_path / "by_hand"
    call = (
        "run",
        cloud,
        "-o",
        by_hand,
        *CALL,
        "--products",
        "dtm,mask",
        "--edits",
        out / "edits.gpkg",
    )
    assert tiler(*call).returncode == 0
    assert output_digests(out) == output_digests(by_hand)
