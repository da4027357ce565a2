"""The table of methods."""

from __future__ import annotations

from collections import UserDict
from collections.abc import MutableMapping
from importlib import import_module
from typing import Any

from ptd.params import parse
from ptd.passes import Method


class _Methods(UserDict[str, Any]):
    """Methods by name. A method given as a module name is imported when it is first used."""

    def __getitem__(self, name: str) -> Any:
        method = self.data[name]
        if isinstance(method, str):
            module, method = method, import_module(method).METHOD
            if method.name != name:
                raise ValueError(
                    f"ptd/methods/__init__.py: METHOD of {module} is called {method.name!r}, not {name!r}; use one name"
                )
            self.data[name] = method
        return method


METHODS: MutableMapping[str, Method] = _Methods(
    auto="ptd.methods.auto.method",
    classic="ptd.methods.classic",
    chen2023="ptd.methods.chen2023.method",
    dong2017="ptd.methods.dong2017.method",
    dong2018="ptd.methods.dong2018.method",
    rarefy="ptd.methods.rarefy",
    ridge2016="ptd.methods.ridge2016.method",
)


def make_params(name: str, texts: dict[str, str] | None = None) -> Any:
    """Make the parameters of a method from ``name=value`` texts, or raise ValueError with one line."""
    if name not in METHODS:
        raise ValueError(f"no method {name!r}; there are {', '.join(METHODS)}")
    return parse(METHODS[name].params, texts or {})
