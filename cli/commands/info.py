"""``tiler info``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import asdict
from typing import Any

import click

from cli.options import json_option
from cli.output import map_lines, print_facts, print_json, print_table, write_lines
from cli.session import TilerCommand
from cli.summary import failed_lines, left_out_lines, memory_text
from tiler.core.words import counted
from tiler.io.locations import as_path
from tiler.observe.progress import duration_text, size_text


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
    from tiler.apps.clouds import COLUMNS, describe_many, is_many, table_row

    if is_many(paths):
        clouds = describe_many(paths)
        if as_json:
            print_json([asdict(cloud) for cloud in clouds])
        else:
            print_table(counted(len(clouds), "cloud"), COLUMNS, list(map(table_row, clouds)))
        return
    from tiler.apps.info import describe
    from tiler.report.runfile import run_file_errors

    description = describe(paths[0])
    if as_json:
        print_json(description)
    else:
        density = description.pop("density_map", None)
        # Only the facts of a run come from a file that may hold anything.
        with (
            run_file_errors(as_path(paths[0]))
            if description["kind"] == "result"
            else nullcontext()
        ):
            facts = _in_words(description)
        print_facts(facts)
        if density is not None:
            write_lines(map_lines(density, sys.stdout.encoding))


def _in_words(description: Mapping[str, Any]) -> dict[str, Any]:
    """Return the description with the names and units that the summary of a run and its report have."""
    from tiler.report.tables import COUNTED, LABELLED

    terrain = {
        "filled": "pixels with a height",
        "marked": "pixels not certified",
        "surveyed": "with a height",
    }
    names = {"counts": COUNTED, "filter": LABELLED, "dtm": terrain}
    facts: dict[str, Any] = {}
    for key, value in description.items():
        if key == "outputs" and value is not None:
            value = {name: size_text(size) for name, size in value.items()}
        elif isinstance(value, Mapping) and key != "tags":
            words: Mapping[Any, str] = names.get(key, {})
            value = _in_words({words.get(name, name): fact for name, fact in value.items()})
        name, text = _TEXTS.get(key, (key, None))
        facts[name] = value if text is None or value is None else text(value)
    return facts


_TEXTS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "quarantined": ("left out", lambda files: [line[12:] for line in left_out_lines(files)]),
    "failed_tasks": ("failed", lambda tasks: [line[12:] for line in failed_lines(tasks)]),
    "seconds": ("time", duration_text),
    "peak_rss_bytes": ("memory", memory_text),
    "size_bytes": ("size", size_text),
    "overlap_work": ("work with halos", lambda ratio: f"{ratio:.2f} times"),
    "resolution_m": ("resolution", lambda metres: None),  # The text of the pixel has the unit.
    "dropped": ("dropped", lambda reasons: reasons or None),
    "unselected": ("unselected", lambda reasons: reasons or None),
}
"""Name and text of facts by their key in the description."""
