"""Small things that people write, and what they are told."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import rasterio

from cli.main import main
from ptd.methods import METHODS
from tests.invariants import clouds
from tests.invariants.runs import do
from tiler.config import RunConfig
from tiler.plan.method import EQUIVALENTS
from tiler.plan.plan_text import wrapped


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(
        clouds.write(tmp_path_factory.mktemp("clouds") / "a.laz", clouds.city(30.0, 1.0))
    )


def error_of(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert main(arguments) == 2
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("method", "nearest"), [("csf", "auto"), ("SMRF", "chen2023"), ("pmf", "chen2023")]
)
def test_methods_of_other_programs_name_what_comes_nearest(
    method: str, nearest: str, cloud: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = error_of(["plan", cloud, "--method", method], capsys)
    assert nearest in text.split(";")[0]
    assert text.count("\n") == 1


def test_no_method_is_said_to_be_missing() -> None:
    both = sorted(EQUIVALENTS.keys() & METHODS.keys())
    assert not both, "remove the row from EQUIVALENTS, and the name from docs/coming-from.md"


def test_out_with_the_name_of_a_file_is_refused_with_the_remedy(
    cloud: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "x.tif"
    for command in ("run", "plan"):
        assert f"use -o {tmp_path / 'x'}, which will contain dtm.tif" in error_of(
            [command, cloud, "-o", str(out)], capsys
        )
    assert not out.exists()


def test_products_add_up(capsys: pytest.CaptureFixture[str], cloud: str) -> None:
    assert main(["plan", cloud, "--products", "dtm,slope", "--products", "dsm"]) == 0
    assert "products    dtm, dsm, slope" in capsys.readouterr().out
    assert RunConfig.from_mapping({"products": ["dtm,dsm", "mask"]}).products == (
        "dtm",
        "dsm",
        "mask",
    )


def test_nodata_can_be_nan() -> None:
    config = RunConfig.from_mapping({"nodata": "nan"})
    assert math.isnan(config.nodata)
    assert json.loads(json.dumps(config.to_json(), allow_nan=False))["nodata"] == "nan"
    assert math.isnan(RunConfig.from_mapping(config.to_json()).nodata)


def test_a_raster_with_nan(cloud: str, tmp_path: Path) -> None:
    summary = do(
        Path(cloud),
        tmp_path / "out",
        nodata="nan",
        products="dtm,mask",
        outline="hull",
        max_edge="3",
    ).summary
    with rasterio.open(tmp_path / "out" / "dtm.tif") as raster:
        assert math.isnan(raster.nodata)
        heights = raster.read(1)
        assert np.count_nonzero(~np.isnan(heights)) == summary["dtm"]["filled"] > 0
        assert np.nanmin(heights) > 0
        assert (raster.read(1, masked=True).mask == np.isnan(heights)).all()
    for name in ("run.json", "stac.json"):
        json.loads(
            (tmp_path / "out" / name).read_text(), parse_constant=lambda text: pytest.fail(text)
        )
    assert (tmp_path / "out" / "report.html").exists()


def test_no_line_of_a_plan_is_long(capsys: pytest.CaptureFixture[str], cloud: str) -> None:
    assert main(["plan", cloud]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(len(line) for line in lines if not line.startswith(("note", "warning"))) <= 120
    assert max(map(len, lines)) < 600
    assert lines[0].startswith("inputs      1 file, ")
    text = "method      " + ", ".join(f"pass {number}" for number in range(99))
    assert " ".join(" ".join(wrapped(text)).split()) == " ".join(text.split())


def test_words_of_other_programs_are_in_the_glossary() -> None:
    text = (Path(__file__).parents[2] / "docs" / "glossary.md").read_text("utf-8")
    headings = "\n".join(line for line in text.splitlines() if line.startswith("## "))
    for word in ("DEM", "CHM", "Hydro-flatten", "CSF", "SMRF", "PMF"):
        assert word in headings
