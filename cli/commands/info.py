"""``tiler info``."""

from __future__ import annotations

import sys

import click

from cli.options import json_option
from cli.output import map_lines, print_facts, print_json, say
from cli.session import READING, TilerCommand


@click.command("info", cls=TilerCommand, reads=READING)
@click.argument("path", metavar="PATH")
@json_option
def command(path: str, as_json: bool) -> None:
    """What a cloud, a store, a result folder or a raster holds.

    Extent, CRS and units; of a cloud its point count, classes and density, with a map of it (all points are read), of
    a store its state, of a raster its size, nodata value and heights.
    """
    from tiler.apps.info import describe

    facts = describe(path)
    if as_json:
        print_json(facts)
    else:
        density = facts.pop("density_map", None)
        print_facts(facts)
        if density is not None:
            for line in map_lines(density, sys.stdout.encoding):
                say(line)
