"""`tiler review --statement`: the page of random squares, its answers, and the statement, of a whole run."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine

from cli.main import main
from tests.integration.test_review import cloud as cloud
from tests.integration.test_review import reviewed as reviewed
from tests.integration.test_review_page import data_of
from tests.scenes.finished import Finished
from tests.tiler.report.results import Reader
from tiler.apps.review import write_review_page
from tiler.apps.statement import write_statement
from tiler.errors import ConfigError, InputError


@pytest.fixture
def out(finished_run: Finished, tmp_path: Path) -> Path:
    shutil.copytree(finished_run[0], tmp_path / "out")
    return tmp_path / "out"


def saved(page: Path, *answers: int) -> Path:
    """The file that the page saves (statement.js) if the first squares get these answers."""
    data = data_of(page)
    draws = [str(draw) for draw in data["draws"]]
    new = dict(zip(draws, (data["shares"][answer] for answer in answers), strict=False))
    file = page.with_name("answers.json")
    file.write_text(json.dumps({"sample": data["sample"], "answers": data["answers"] | new}))
    return file


def made(out: Path, capsys: pytest.CaptureFixture[str], *options: str) -> dict[str, Any]:
    assert main(["review", str(out), "--statement", "--json", *options]) == 0
    return dict(json.loads(capsys.readouterr().out))


@pytest.mark.slow
def test_answers_become_a_statement_and_the_next_page(
    out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.read_bytes() for path in out.glob("*.*") if path.is_file()}
    first = made(out, capsys, "--places", "4")
    page = Path(first["page"])
    assert page == out / "statement.html"
    assert first["text"].startswith("no answer counts yet: of ")
    with rasterio.open(out / "dtm.tif") as raster:
        assert first["terrain_m2"] == (~raster.read(1, masked=True).mask).sum()
    assert first["max_m2"] == first["rising_m2"] > 0
    assert first["confidence"] == 0.95
    data = data_of(page)
    assert data["draws"][0] == 1
    assert data["answers"] == {}
    reader = Reader()
    reader.feed(page.read_text("utf-8"))
    assert reader.tags.count("article") == first["shown"] == 4
    assert page.read_text("utf-8").count("ground (brown)") == 4

    answers = str(saved(page, 1, 0, 4, 0))
    second = made(out, capsys, "--places", "3", "--answers", answers)
    assert second["seen"] == 4
    assert second["draws"] >= 4
    assert second["with_objects"] >= 2
    assert second["max_m2"] <= first["max_m2"]
    assert second["text"].startswith("at most ")
    after = data_of(page)
    assert after["sample"] == data["sample"]
    assert len(after["answers"]) == 4
    assert min(after["draws"]) == second["draws"] + 1

    # A gap: the later answers wait.
    content = json.loads(Path(answers).read_text())
    del content["answers"]["1"]
    Path(answers).write_text(json.dumps(content))
    gap = made(out, capsys, "--answers", answers)
    assert (gap["draws"], gap["waiting"], gap["with_objects"]) == (0, 3, 0)

    assert made(out, capsys, "--places", "1000")["shown"] == first["squares"]
    answers = str(saved(page, *[2] * first["squares"]))
    everything = made(out, capsys, "--places", "1000", "--answers", answers)
    assert everything["seen"] == everything["squares"]
    assert everything["max_m2"] == 0.5 * first["rising_m2"]
    assert everything["page"] == ""
    changed = {path for path, content in before.items() if path.read_bytes() != content}
    assert not changed


def test_the_lines_have_the_statement_and_the_page(
    out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["review", str(out), "--statement", "--places", "2"]) == 0
    statement, page = capsys.readouterr().out.splitlines()
    assert (
        "draws without an object that are needed, 95 % sure: " in statement
    ) or "look at " in statement
    assert page == f"page  {out / 'statement.html'}: 2 squares to answer next"


def test_draws_follow_from_the_terrain(out: Path) -> None:
    page = Path(write_statement(out, 5).page)
    first = data_of(page)
    assert write_statement(out, 5).page == str(page)
    assert data_of(page) == first
    answers = saved(page, 0)
    with rasterio.open(out / "dtm.tif") as raster:
        values, profile = raster.read(1), raster.profile
    with rasterio.open(out / "dtm.tif", "w", **profile) as raster:
        raster.write(np.where(values == profile["nodata"], values, values + 3), 1)
    assert data_of(Path(write_statement(out, 5).page))["sample"] != first["sample"]
    with pytest.raises(InputError, match=r"answers.json: its answers are of another terrain"):
        write_statement(out, answers=answers)


def write_dtm(out: Path, side_m: float, empty: bool = False) -> None:
    """Write the heights of a run again, in pixels of another size, or without any height."""
    with rasterio.open(out / "dtm.tif") as raster:
        values, profile = raster.read(1)[:60, :60], raster.profile
    x, y = profile["transform"].c, profile["transform"].f
    profile |= {"width": 60, "height": 60, "transform": Affine(side_m, 0, x, 0, -side_m, y)}
    with rasterio.open(out / "dtm.tif", "w", **profile) as raster:
        raster.write(np.full_like(values, profile["nodata"]) if empty else values, 1)


@pytest.mark.parametrize("side_m", [0.1, 5.0])
def test_pixels_of_10_cm_and_of_5_m_are_stated(side_m: float, out: Path) -> None:
    write_dtm(out, side_m)
    statement = write_statement(out, 1)
    with rasterio.open(out / "dtm.tif") as raster:
        pixels = (~raster.read(1, masked=True).mask).sum()
    assert statement.terrain_m2 == pytest.approx(pixels * side_m**2)


@pytest.mark.parametrize(("side_m", "text"), [(0.09, "0.09 m"), (5.1, "5.1 m")])
def test_smaller_and_larger_pixels_are_refused(side_m: float, text: str, out: Path) -> None:
    write_dtm(out, side_m)
    with pytest.raises(InputError) as error:
        write_statement(out)
    assert str(error.value) == (
        f"{out / 'dtm.tif'}: has pixels of {text}, and a statement needs 0.1 m to 5 m; run with another --resolution "
        "into another OUT"
    )


def test_a_terrain_without_heights_is_refused(out: Path) -> None:
    write_dtm(out, 1.0, empty=True)
    with pytest.raises(InputError, match=r"dtm.tif: has no heights, .*; run again"):
        write_statement(out)
    assert not (out / "statement.html").exists()


def test_what_cannot_be_stated_is_one_line(
    out: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["review", str(out), "--answers", "a.json"]) == 2
    assert (
        "--answers a.json: is for --statement only; add --statement" in capsys.readouterr().err
    )
    with pytest.raises(ConfigError, match="is a URL"):
        write_statement(out, answers="https://example.org/answers.json")
    with pytest.raises(InputError, match=r"none.json: is no file"):
        write_statement(out, answers=tmp_path / "none.json")
    with pytest.raises(InputError, match="has no results of a run"):
        write_statement(tmp_path)
    other = tmp_path / "mine.html"
    other.write_text("mine")
    with pytest.raises(ConfigError, match="exists and is not a page of this command"):
        write_statement(out, page_path=other)
    with pytest.raises(ConfigError, match="is an input"):
        write_statement(out, page_path=other, answers=other)
    (out / "dtm.tif").write_bytes(b"cut off")
    with pytest.raises(InputError, match=r"dtm.tif: cannot be read"):
        write_statement(out)
    (out / "dtm.tif").unlink()
    with pytest.raises(InputError, match="contains no DTM"):
        write_statement(out)
    assert other.read_text() == "mine"


def test_sheets_are_one_terrain_and_without_rise_there_is_no_sample(reviewed: Path) -> None:
    """A gentle slope with voids, in sheets of 80 m."""
    statement = write_statement(reviewed)
    with rasterio.open(reviewed / "dtm.vrt") as raster:
        assert statement.terrain_m2 == (~raster.read(1, masked=True).mask).sum()
    assert (statement.page, statement.max_m2, statement.squares) == ("", None, 0)
    assert statement.text.startswith("no square to look at: none of ")
    assert not (reviewed / "statement.html").exists()


def test_the_page_of_places_stays(out: Path) -> None:
    assert write_statement(out, 1).page != write_review_page(out).page
