"""``tiler classify``."""

from __future__ import annotations

from typing import Any

import click

from cli.options import config_options, json_option, read_config
from cli.output import print_facts, print_json, write_lines
from cli.session import TilerCommand, current_session, shown_progress
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
    "reclass",
    "returns",
    "scan_angle",
    "source_id",
    "drop_classes",
    "withheld",
    "skip_synthetic",
    "skip_overlap",
    "salvage",
)

NOT_PRINTED = ("parameters", "failed_tasks", "exit_code", "quarantined")
"""Facts that are only in the JSON, or that are printed in another form."""


@click.command("classify", cls=TilerCommand, progress=True, reads=True)
@click.argument("source", metavar="IN...", nargs=-1, required=True, type=click.Path())
@click.argument("target", metavar="OUT", type=click.Path())
@config_options(only=SETTINGS)
@json_option
def command(source: tuple[str, ...], target: str, as_json: bool, **settings: Any) -> int:
    """Classify the points of one file or of many, without a store.

    If IN is one file, OUT.laz (or OUT.las) gets its points in the same order, with new classes.
    OUT.copc.laz gets them in spatial order. If IN is several files, a folder or a glob, OUT is
    a folder and gets a LAZ file for each. Each file is classified together with the points of
    its neighbours, so no file border is visible in the classes. Only ground and low noise get
    new classes, unless --reclass all is given. A single file does not need a CRS: without one,
    its coordinates are in metres, or in the unit of --units. If a tile fails, its points keep
    the classes of IN, the output lists the tile, and the exit code is 5.
    """
    config = read_config(settings)
    from tiler.preparation import prepare_workers

    # The workers import their libraries while this process imports its own.
    prepare_workers(config, target)
    from tiler.apps.classify import classify_file, classify_files, is_one_file

    with shown_progress() as listener:
        if is_one_file(source, target):
            summary = classify_file(source[0], target, config, listener)
        else:
            summary = classify_files(source, target, config, listener)
    if as_json:
        print_json(summary)
    elif not current_session().quiet:
        print_facts({n: value for n, value in summary.items() if n not in NOT_PRINTED})
        left_out = summary.get("quarantined", [])
        write_lines(f"left out    {file['path']}: {file['error']}" for file in left_out)
        write_lines(failed_lines(summary["failed_tasks"]))
    return summary["exit_code"]
