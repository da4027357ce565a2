"""The table of methods."""

from __future__ import annotations

from typing import Any

from ptd.methods import classic, rarefy
from ptd.methods.auto import method as auto
from ptd.methods.chen2023 import method as chen2023
from ptd.methods.dong2017 import method as dong2017
from ptd.methods.dong2018 import method as dong2018
from ptd.methods.ridge2016 import method as ridge2016
from ptd.params import parse
from ptd.passes import Method

METHODS: dict[str, Method] = {
    m.name: m
    for m in (
        auto.METHOD,
        classic.METHOD,
        chen2023.METHOD,
        dong2017.METHOD,
        dong2018.METHOD,
        rarefy.METHOD,
        ridge2016.METHOD,
    )
}


def make_params(name: str, texts: dict[str, str] | None = None) -> Any:
    """Parameters of a method from ``name=value`` texts; raises ValueError with one line."""
    if name not in METHODS:
        raise ValueError(f"no method {name!r}; there are {', '.join(METHODS)}")
    return parse(METHODS[name].params, texts or {})
