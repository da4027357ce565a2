"""``tiler methods``."""

from __future__ import annotations

import dataclasses
from typing import Any

import click

from cli.options import json_option
from cli.output import print_json, print_table
from cli.session import TilerCommand
from tiler.errors import ConfigError

COLUMNS = ("parameter", "default", "unit", "range", "source", "meaning")


@click.command("methods", cls=TilerCommand)
@click.argument("name", metavar="[METHOD]", required=False)
@json_option
def command(name: str | None, as_json: bool) -> None:
    """List the ground filters and their parameters.

    Lists every method, or only METHOD, with default, unit, range and source of each parameter. In other commands
    `--method METHOD` chooses a method, and `--set PARAMETER=VALUE` changes a parameter. You can leave out the unit at
    the end of the parameter's name. `--method keep` does not filter: it uses the classes of the input.
    """
    from ptd.methods import METHODS

    if name is not None and name not in METHODS:
        raise ConfigError(f"no method {name!r}; there are {', '.join(METHODS)}")
    chosen = {n: m for n, m in METHODS.items() if name in (None, n)}
    if as_json:
        print_json(
            {
                n: {"summary": m.summary, "parameters": parameter_facts(m.params)}
                for n, m in chosen.items()
            }
        )
        return
    for n, method in chosen.items():
        rows = [
            (
                p["name"],
                _text(p["default"]),
                p["unit"],
                range_text(p["minimum"], p["maximum"]),
                p["source"],
                p["help"],
            )
            for p in parameter_facts(method.params)
        ]
        print_table(f"{n}: {method.summary}", COLUMNS, rows)


def parameter_facts(params: Any) -> list[dict[str, Any]]:
    """Return name, default and metadata of each field of a parameter dataclass."""
    return [
        {"name": f.name, "default": f.default, **f.metadata} for f in dataclasses.fields(params)
    ]


def _text(value: Any) -> str:
    return ("yes" if value else "no") if isinstance(value, bool) else str(value)


def range_text(minimum: float | None, maximum: float | None) -> str:
    """Return the range of a value as text, or an empty text if it has no limit."""
    if minimum is None and maximum is None:
        return ""
    if maximum is None:
        return f">= {minimum:g}"
    if minimum is None:
        return f"<= {maximum:g}"
    return f"{minimum:g} to {maximum:g}"
