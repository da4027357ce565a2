"""``tiler classify``."""

from __future__ import annotations

from typing import Any

import click

from cli.exit_codes import DONE, PARTIAL
from cli.options import config_options, json_option, read_config
from cli.output import print_facts, print_json, say
from cli.session import READING, TilerCommand, current_session, shown_progress
from cli.summary import failed_lines

SETTINGS = (
    "method",
    "parameters",
    "sigma",
    "kind",
    "tile_size",
    "halo",
    "memory",
    "workers",
    "units",
    "keep_classes",
    "skip_synthetic",
    "skip_overlap",
    "salvage",
)


@click.command("classify", cls=TilerCommand, progress=True, reads=READING)
@click.argument("source", metavar="IN", type=click.Path())
@click.argument("target", metavar="OUT.laz", type=click.Path())
@config_options(only=SETTINGS)
@json_option
def command(source: str, target: str, as_json: bool, **settings: Any) -> int:
    """Classify the points of one file; leaves no store behind.

    OUT.laz (or OUT.las) gets the points of IN in the same order, with new classes; OUT.copc.laz has them by place.
    Needs no CRS: where IN has none, its coordinates are taken for metres, or for what --units says. Where a tile fails
    its points keep the classes of IN: the tile is named, and the exit code is 5.
    """
    config = read_config(settings)
    from tiler.apps.classify import classify_file

    session = current_session()
    with shown_progress() as listener:
        facts = classify_file(source, target, config, listener)
    if as_json:
        print_json(facts)
    elif not session.quiet:
        print_facts({n: value for n, value in facts.items() if n not in ("parameters", "failed_tasks")})
        for line in failed_lines(facts["failed_tasks"]):
            say(line)
    return PARTIAL if facts["failed_tasks"] else DONE
