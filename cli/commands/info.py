"""``tiler info``."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import click

from cli.options import json_option
from cli.output import map_lines, print_facts, print_json, print_table, write_line
from cli.session import TilerCommand
from tiler.core.words import counted


@click.command("info", cls=TilerCommand, reads=True)
@click.argument("paths", metavar="PATH...", nargs=-1, required=True)
@json_option
def command(paths: tuple[str, ...], as_json: bool) -> None:
    """Describe clouds, a store, a result folder or a raster.

    Prints extent, CRS and units. For a cloud it also prints the number of points, the classes,
    and the density with a map, for which it reads all points. For a store it prints the state,
    for a raster the size, nodata value and heights. For several clouds, a folder of clouds
    or a virtual point cloud (.vpc), it prints a table with one row per cloud, for which it
    reads only the headers and a few points.
    """
    from tiler.apps.info_table import COLUMNS, describe_many, is_many, rows

    if is_many(paths):
        clouds = describe_many(paths)
        if as_json:
            print_json([asdict(cloud) for cloud in clouds])
        else:
            print_table(counted(len(clouds), "cloud"), COLUMNS, rows(clouds))
        return
    from tiler.apps.info import describe

    description = describe(paths[0])
    if as_json:
        print_json(description)
    else:
        density = description.pop("density_map", None)
        print_facts(_in_words(description))
        if density is not None:
            for line in map_lines(density, sys.stdout.encoding):
                write_line(line)


def _in_words(description: Mapping[str, Any]) -> dict[str, Any]:
    """Return the description with the names that the report has for the counts of a run."""
    from tiler.report.tables import COUNTED, LABELLED

    terrain = {
        "filled": "pixels with a height",
        "marked": "pixels not certified",
        "surveyed": "of the survey has a height",
    }
    names = {"counts": COUNTED, "filter": LABELLED, "dtm": terrain}
    return {
        key: {names[key].get(name, name): number for name, number in value.items()}
        if key in names and isinstance(value, Mapping)
        else value
        for key, value in description.items()
    }
