"""``tiler plan``."""

from __future__ import annotations

from typing import Any

import click

from cli.options import config_options, inputs_argument, json_option, read_config
from cli.output import print_json
from cli.session import TilerCommand


@click.command("plan", cls=TilerCommand)
@inputs_argument
@config_options()
@json_option
def command(inputs: tuple[str, ...], as_json: bool, **settings: Any) -> None:
    """Dry run: what a run would do, and what it needs.

    Points, tiles, memory, disk and time of `tiler run` with the same INPUT and options. Reads the headers of the
    files and a few thousand points of each, writes nothing; what a run would refuse is refused here with the same line.
    """
    config = read_config(settings)
    from tiler.plan import make_plan, plan_json, plan_lines

    plan = make_plan(inputs, config)
    if as_json:
        print_json(plan_json(plan))
    else:
        for line in plan_lines(plan):
            click.echo(line)
