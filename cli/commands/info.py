"""``tiler info``."""

from __future__ import annotations

import click

from cli.options import json_option
from cli.output import print_facts, print_json
from cli.session import TilerCommand


@click.command("info", cls=TilerCommand)
@click.argument("path", metavar="PATH")
@json_option
def command(path: str, as_json: bool) -> None:
    """What a cloud, a store, a result folder or a raster holds.

    Extent, CRS and units; of a cloud its point count, density and classes (all points are read), of a store
    its state, of a raster its size, nodata value and heights.
    """
    from tiler.info import describe

    facts = describe(path)
    if as_json:
        print_json(facts)
    else:
        print_facts(facts)
