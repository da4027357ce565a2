"""The page of the check of clouds has every row, the worst first, and is written only over an earlier one."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.tiler.apps.acceptance.pulses import Pulses, lattice
from tests.tiler.report import results
from tiler.apps.acceptance import check_clouds
from tiler.apps.acceptance.page import MAX_ROWS, acceptance_page
from tiler.apps.acceptance.rows import NAMES
from tiler.apps.acceptance.specification import read_specification
from tiler.apps.results import AcceptanceRow, AcceptanceSummary
from tiler.errors import ConfigError


def row(name: str, state: str, found: float | None = 1.5) -> AcceptanceRow:
    asked = None if state == "not asked" else 2.0
    return {
        "name": name, "unit": "per m2", "limit": "at least", "asked": asked, "found": found, "state": state,
        "where": [results.HOSTILE], "remark": f"remark of {name}",
    }  # fmt: skip


def summary(*rows: AcceptanceRow, clouds: int = 1) -> AcceptanceSummary:
    return {
        "clouds": [f"/data/{number}.laz" for number in range(clouds)], "points": 1234567, "specification": "contract",
        "cell_m": 1.4, "met": False, "rows": list(rows), "swath_pairs": [], "difference": None, "style": None,
        "page": None, "notes": ["a note"],
    }  # fmt: skip


def read(content: bytes, tmp_path: Path) -> results.Reader:
    (tmp_path / "page.html").write_bytes(content)
    return results.read(tmp_path / "page.html")


def test_rows_that_do_not_meet_the_specification_come_first(tmp_path: Path) -> None:
    states = ("not asked", "pass", "fail", "not measured")
    rows = [row(f"row_{state[:5]}", state) for state in states]
    page = read(acceptance_page(summary(*rows)), tmp_path)
    text = page.texts["rows"]
    order = sorted(states, key=lambda state: text.index(f"remark of row_{state[:5]}"))
    assert order == ["fail", "not measured", "pass", "not asked"]
    assert "at least 2 per m2" in text
    assert "1.5 per m2" in text
    assert "NOT met: 2 of 3 rows of contract" in page.texts[""]
    assert ("p", "class", "state bad") in page.attributes
    assert "a note" in page.texts["notes"]


def test_names_of_files_do_not_become_markup(tmp_path: Path) -> None:
    page = read(acceptance_page(summary(row("voids", "fail"))), tmp_path)
    assert not {"img", "script"} & set(page.tags)
    assert "onerror" in page.texts["rows"]


def test_many_clouds_are_cut_off(tmp_path: Path) -> None:
    page = read(acceptance_page(summary(clouds=MAX_ROWS + 5)), tmp_path)
    assert page.texts["clouds"].count(".laz") == MAX_ROWS
    assert "5 more are in the output of --json" in page.texts["clouds"]


def test_the_page_has_what_was_measured(tmp_path: Path) -> None:
    both = Pulses(*lattice(0, 40, 0, 30), 1) + Pulses(*lattice(20, 60, 0, 30), 2)
    cloud, target = both.write(tmp_path / "a.laz"), tmp_path / "check.html"
    (tmp_path / "asked.toml").write_text("pulse_density = 400\n")
    for _ in range(2):  # The second page replaces the first.
        asked = read_specification(str(tmp_path / "asked.toml"))
        found = check_clouds([cloud], asked, page=target)
    assert found["page"] == str(target)
    page = results.read(target)
    for name in set(NAMES) - {"missing_sheets"}:
        assert name.replace("_", " ") in page.texts["rows"]
    assert "NOT met: 1 of 1 row" in page.texts[""]
    pair = found["swath_pairs"][0]
    assert f"2 - 1 {pair['cells']:,} of {pair['shared_cells']:,}" in page.texts["pairs"]
    assert str(cloud) in page.texts["clouds"]


def test_a_page_that_cannot_be_written_is_refused_before_clouds_are_read(
    tmp_path: Path,
) -> None:
    cloud = tmp_path / "a.laz"
    cloud.write_text("this is not a cloud")
    (tmp_path / "mine.html").write_text("mine")
    for page, reason in (
        ("mine.html", "exists and is not a page of this command"),
        ("a.laz", "suffix does not match"),
        ("none/page.html", "its folder does not exist"),
    ):
        with pytest.raises(ConfigError, match=f"--page .*{reason}"):
            check_clouds([cloud], page=tmp_path / page)
    with pytest.raises(ConfigError, match="is a URL"):
        check_clouds([cloud], page=Path("s3://bucket/page.html"))
    assert (tmp_path / "mine.html").read_text() == "mine"
