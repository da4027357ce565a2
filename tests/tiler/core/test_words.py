"""Lists and names in texts for users."""

from __future__ import annotations

import pyproj
import pytest

from tiler.core.words import alternatives, counted, listed, name_in_wkt


@pytest.mark.parametrize(
    ("number", "plural", "text"),
    [(1, None, "1 lake"), (0, None, "0 lakes"), (2_000, "loughs", "2,000 loughs")],
)
def test_a_noun_has_the_number_of_its_count(number: int, plural: str | None, text: str) -> None:
    assert counted(number, "lake", plural) == text


@pytest.mark.parametrize(
    ("texts", "text"),
    [
        ([], ""),
        (["a"], "a"),
        (["a", "b"], "a, b"),
        (["a", "b", "c"], "a, b and 1 more"),
        (["a"] * 2_002, "a, a and 2,000 more"),
    ],
)
def test_a_list_has_its_first_texts_and_the_number_of_the_others(
    texts: list[str], text: str
) -> None:
    assert listed(texts, 2) == text


def test_a_list_may_have_a_noun() -> None:
    assert listed(["a", "b", "c"], 1, "files") == "a and 2 more files"


def test_alternatives_are_joined_by_or() -> None:
    assert alternatives(["LAS"]) == "LAS"
    assert alternatives(["LAS", "LAZ"]) == "LAS or LAZ"
    assert alternatives(["LAS", "LAZ", "text"]) == "LAS, LAZ or text"


@pytest.mark.parametrize("version", ["WKT1_GDAL", "WKT2_2019"])
def test_the_name_of_a_crs_is_that_of_pyproj(version: str) -> None:
    crs = pyproj.CRS("EPSG:25832")
    assert name_in_wkt(crs.to_wkt(version)) == crs.name


def test_texts_without_a_name_are_names() -> None:
    assert (name_in_wkt(None), name_in_wkt(None, "none"), name_in_wkt("LOCAL")) == (
        "unknown",
        "none",
        "LOCAL",
    )
