"""Names of sheets from a template, and templates that are refused."""

from __future__ import annotations

import pytest

from tiler.config import RunConfig
from tiler.core.file_names import (
    DEFAULT,
    check_template,
    name_prefix,
    product_names,
    sheet_name,
    validate_distinct_names,
)
from tiler.errors import ConfigError


@pytest.mark.parametrize(
    ("template", "name"),
    [
        (DEFAULT, "dtm_292000_6832000.5"),
        ("LHD_FXX_{x_km:04.0f}_{north_km:04.0f}_{name}", "LHD_FXX_0292_6833_dtm"),
        ("{name}-{east:.0f}x{y:010.1f}", "dtm-293000x06832000.5"),
    ],
)
def test_names_follow_the_template(template: str, name: str) -> None:
    assert (
        sheet_name(check_template(template), "dtm", (292000.0, 6832000.5, 293000.0, 6833000.5))
        == name
    )
    assert name.startswith(name_prefix(template, "dtm"))


@pytest.mark.parametrize(
    ("template", "why"),
    [
        ("{name}", "the same name"),
        ("{name}_{x_km:.0f}", "the same name"),
        ("{name}/{x}_{y}", "'/'"),
        (".{x}_{y}", "begins with a dot"),
        ("aux.{x}_{y}", "the name of a device on Windows"),
        ("{x}_{y}_{tile}", "no field {tile}; use name, x, y"),
        ("{x.real}_{y}", "no field {x.real}"),
        ("{x:Q}_{y}", "use a template like"),
        ("{x}_{y", "use a template like"),
        ("{name:_>300}{x}{y}", "more than 200"),
    ],
)
def test_a_template_that_cannot_name_files_is_refused(template: str, why: str) -> None:
    with pytest.raises(ConfigError) as error:
        check_template(template)
    assert why in str(error.value)


def test_products_have_other_names() -> None:
    names = product_names("dtm=MNT, dsm = MNS")
    assert (names["dtm"], names["dsm"], names["mask"]) == ("MNT", "MNS", "mask")
    assert product_names("dtm=DSM,dsm=dtm")["dsm"] == "dtm"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("dtx=MNT", "no product 'dtx'; use dtm, dsm, "),
        ("MNT", "is not valid; give dtm=NAME"),
        ("", "is not valid; give dtm=NAME"),
        ("dtm=", "'' is empty"),
        ("dtm=M/T", "'M/T' contains '/'"),
        ("dtm=nul", "'nul' is the name of a device on Windows"),
        ("dtm=" + 201 * "M", "has more than 200 bytes"),
        ("dtm=M,dsm=m", "several products have the name 'M'"),
        ("dtm=dsm", "several products have the name 'dsm'"),
    ],
)
def test_names_of_products_that_cannot_be_are_refused(text: str, why: str) -> None:
    with pytest.raises(ConfigError) as error:
        RunConfig.from_mapping({"product_name": text})
    assert why in str(error.value)


def test_no_two_sheets_have_one_name() -> None:
    validate_distinct_names(DEFAULT, ["a_1", "a_2"])
    with pytest.raises(
        ConfigError, match="two sheets would have the name A_1; use more digits"
    ):
        validate_distinct_names(DEFAULT, ["a_1", "A_1"])


def test_the_name_of_a_drawn_sheet_is_a_field() -> None:
    edges = (292000.0, 6832000.0, 293000.0, 6833000.0)
    assert sheet_name(check_template("{sheet}"), "dtm", edges, "Köln") == "Köln"
    assert sheet_name(check_template("{sheet:_>4}{x_km}"), "dtm", edges, "7") == "___7292"
