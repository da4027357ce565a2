"""The table of methods: mistakes in a new method end in one line that names what to write."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from ptd.methods import METHODS
from ptd.methods.classic import ClassicPass
from ptd.methods.rarefy import Rarefy
from ptd.params import parameter
from ptd.passes import Method, Pass


@dataclass(frozen=True)
class Incomplete:
    """Parameters whose pass has a variable halo, or a radius of 1 m."""

    size_m: float = parameter(1.0, "a size", unit="m")
    candidate_cell_m = 0.0

    @property
    def passes(self) -> tuple[Pass, ...]:
        return (ClassicPass(Rarefy()),)


class Local(ClassicPass):
    influence_radius_m = 1.0


class WithRadius(Incomplete):
    @property
    def passes(self) -> tuple[Pass, ...]:
        return (Local(Rarefy()),)


@dataclass(frozen=True)
class Plain(WithRadius):
    extra: int = 3


class Empty: ...


def test_a_method_without_a_needed_property_is_refused() -> None:
    with pytest.raises(TypeError, match=r"^method mine: its parameters have no halo_m; add "):
        Method("mine", "", Incomplete)
    with pytest.raises(TypeError, match=r"^method mine: its parameters have no passes; add "):
        Method("mine", "", dataclass(Empty))


def test_passes_with_a_fixed_radius_need_no_halo() -> None:
    assert Method("mine", "", WithRadius).params is WithRadius


def test_a_parameter_without_help_and_range_is_refused() -> None:
    with pytest.raises(
        TypeError, match=r"^method mine: extra is a plain field; use ptd\.params"
    ):
        Method("mine", "", Plain)


def test_a_method_with_another_name_than_its_row_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(METHODS.data, "mine", "ptd.methods.rarefy")  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match=r"METHOD of ptd\.methods\.rarefy .* not 'mine'; use"):
        METHODS["mine"]
