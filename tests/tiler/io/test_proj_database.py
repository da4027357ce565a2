"""A variable of another GIS program must not take the CRS from GeoTIFFs."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.invariants import clouds
from tiler.io.proj_database import validate_proj_database


def test_nothing_is_checked_without_the_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("PROJ_DATA", "PROJ_LIB"):
        monkeypatch.delenv(name, raising=False)
    validate_proj_database()


@pytest.mark.processes
@pytest.mark.parametrize(
    ("name", "value"),
    [("PROJ_DATA", "here"), ("PROJ_LIB", "here"), ("PROJ_DATA", ""), ("PROJ_LIB", "/nowhere")],
)
def test_a_folder_without_a_database_is_refused_before_the_run(
    name: str, value: str, tmp_path: Path
) -> None:
    """GDAL keeps the first folder that it finds, so each case needs its own process."""
    cloud = clouds.write(tmp_path / "town.laz", clouds.city(20.0, 2.0))
    environment = {k: v for k, v in os.environ.items() if k not in ("PROJ_DATA", "PROJ_LIB")}
    environment[name] = value.replace("here", str(tmp_path))
    command = [sys.executable, "-m", "cli.main", "plan", str(cloud)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    line = f"tiler: error: {name}={environment[name]}: GDAL finds no database of PROJ there that fits, and would write"
    assert done.stderr.startswith(line)
    assert done.stderr.rstrip().endswith(f"unset {name} and try again")
    assert done.stderr.count("\n") == 1


@pytest.mark.processes
def test_the_database_of_the_installation_may_be_named(tmp_path: Path) -> None:
    import rasterio

    folder = Path(rasterio.__file__).parent / "proj_data"
    if not (folder / "proj.db").exists():
        pytest.skip("this installation of rasterio brings no database of PROJ")
    code = "from tiler.io.proj_database import validate_proj_database as check; check()"
    environment = {**os.environ, "PROJ_DATA": str(folder)}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
