"""Ranges of parameters, and their values from texts."""

from __future__ import annotations

import itertools
import re
import sys
from dataclasses import dataclass, fields, replace

import pytest

from ptd.methods import METHODS, make_params
from ptd.methods.classic import Classic, Progressive
from ptd.params import check, like, parameter, parse, to_json


@dataclass(frozen=True)
class Sample:
    length_m: float = parameter(2.0, "a length", unit="m", minimum=0.5, maximum=10.0)
    angle_deg: float = parameter(0.0, "an angle", unit="deg", minimum=0.0, maximum=90.0)
    times: int = parameter(1, "a number", minimum=0, maximum=9)
    free: float = parameter(1.0, "any number")
    switch: bool = parameter(True, "a switch")

    def __post_init__(self) -> None:
        check(self)


def test_texts_are_read_by_the_type_of_the_default() -> None:
    texts = {"length_m": "3.5", "angle_deg": "1e1", "times": "4", "free": "-7", "switch": "no"}
    assert parse(Sample, texts) == Sample(3.5, 10.0, 4, -7.0, False)
    assert parse(Sample, {}) == Sample()


@pytest.mark.parametrize(("alias", "full"), [("length", "length_m"), ("angle", "angle_deg")])
def test_a_name_may_omit_its_unit(alias: str, full: str) -> None:
    assert parse(Sample, {alias: "4"}) == replace(Sample(), **{full: 4.0})


def test_words_that_are_true_or_false() -> None:
    assert all(
        parse(Sample, {"switch": text}).switch is True for text in ("true", "YES", "1", "True")
    )
    assert all(parse(Sample, {"switch": text}).switch is False for text in ("false", "No", "0"))


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (
            {"width": "1"},
            "no parameter 'width'; there are length_m, angle_deg, times, free, switch",
        ),
        ({"switch_m": "1"}, "no parameter 'switch_m'"),
        ({"length": "1", "length_m": "2"}, "length_m: given twice"),
        ({"length": "long"}, "length_m 'long': must be a number"),
        ({"length": ""}, "length_m '': must be a number"),
        ({"times": "2.5"}, "times '2.5': must be a whole number"),
        ({"switch": "maybe"}, "switch 'maybe': must be true or false"),
        ({"length": "0.4"}, "length_m 0.4: must be between 0.5 and 10 m"),
        ({"length": "nan"}, "length_m nan: must be between 0.5 and 10 m"),
        ({"length": "inf"}, "length_m inf: must be between 0.5 and 10 m"),
        ({"angle": "-1"}, "angle_deg -1: must be between 0 and 90 deg"),
        ({"times": "10"}, "times 10: must be between 0 and 9"),
    ],
)
def test_texts_that_are_refused(texts: dict[str, str], message: str) -> None:
    with pytest.raises(ValueError) as error:
        parse(Sample, texts)
    assert str(error.value).startswith(message)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"angle_deg": True}, "angle_deg True: must be a number"),
        ({"times": False}, "times False: must be a whole number"),
        ({"times": 2.0}, "times 2.0: must be a whole number"),
        ({"switch": 1}, "switch 1: must be true or false"),
        ({"length_m": "3"}, "length_m '3': must be a number"),
        ({"length_m": None}, "length_m None: must be a number"),
        (
            {"length_m": 1.0936132983377},
            "length_m 1.0936132983377: write at most 6 decimals, as 1.093613",
        ),
    ],
)
def test_values_of_another_type_are_refused(values: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError) as error:
        Sample(**values)
    assert str(error.value) == message


BESIDE = {
    "first_spacing_m": {"last_spacing_m": 0.25},
    "last_spacing_m": {"first_spacing_m": 50.0},
}
"""Values with which the limits of another parameter can be reached."""


@pytest.mark.parametrize("method", METHODS)
def test_each_limit_of_each_parameter_holds(method: str) -> None:
    params = METHODS[method].params
    for spec, (end, beyond) in itertools.product(
        fields(params), (("minimum", -1), ("maximum", 1))
    ):
        limit, kind = spec.metadata[end], type(spec.default)
        if limit is not None:
            other = {
                name: v
                for name, v in BESIDE.get(spec.name, {}).items()
                if hasattr(params, name)
            }
            assert getattr(params(**{spec.name: kind(limit)}, **other), spec.name) == limit
            with pytest.raises(ValueError, match=rf"^{spec.name} .*: must be between "):
                params(**{spec.name: kind(limit + beyond)})


@pytest.mark.parametrize("method", METHODS)
def test_each_parameter_has_help_and_a_source_that_people_can_find(method: str) -> None:
    for spec in fields(METHODS[method].params):
        assert spec.metadata["help"]
        assert not spec.metadata["source"][:1].isdigit(), spec.name
        unit = spec.metadata["unit"]
        assert (unit == "m") == spec.name.endswith("_m")
        assert (unit == "deg") == spec.name.endswith("_deg")


def test_spacings_that_grow_are_refused() -> None:
    with pytest.raises(
        ValueError, match=r"^last_spacing_m 8: use at most first_spacing_m, 4 m$"
    ):
        METHODS["dong2017"].params(last_spacing_m=8.0)


def test_methods_by_name() -> None:
    assert make_params("classic") == Classic()
    assert make_params("classic", {"iteration_angle": "6"}).iteration_angle_deg == 6.0
    with pytest.raises(ValueError, match="no method 'best'; there are auto, classic"):
        make_params("best")


def test_json_gives_the_parameters_back() -> None:
    params = Classic(rounds=3, label_pass=False)
    assert Classic(**to_json(params)) == params
    assert list(to_json(params)) == [spec.name for spec in fields(Classic)]


def test_a_field_like_that_of_another_method() -> None:
    @dataclass(frozen=True)
    class Other:
        rounds: int = like(Classic, "rounds", 3)
        low_radius_m: float = like(Classic, "low_radius_m")

    assert to_json(Other()) == {"rounds": 3, "low_radius_m": Classic().low_radius_m}
    (rounds,) = [field for field in fields(Classic) if field.name == "rounds"]
    assert fields(Other)[0].metadata == rounds.metadata


@pytest.mark.parametrize("name", METHODS)
def test_the_table_of_a_method_names_its_parameters_and_their_defaults(name: str) -> None:
    """The table in the module's docstring; names after the first of a row may be cut to their last part."""
    params = METHODS[name].params
    table = str(sys.modules[params.__module__].__doc__)
    bases = [base for base in params.__mro__[1:] if base in (Progressive, Classic)]
    inherited = {field.name for base in bases for field in fields(base)} - set(
        params.__annotations__
    )
    for field in fields(params):
        short = re.sub("_(m|deg)$", "", field.name)
        assert field.name in inherited or short in table or short.rsplit("_", 1)[-1] in table, (
            field.name
        )
        if field.name not in inherited:
            default = {True: "on", False: "off"}.get(field.default, field.default)
            assert (default if isinstance(default, str) else f"{default:g}") in table, (
                field.name
            )
