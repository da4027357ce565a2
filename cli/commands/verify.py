"""``tiler verify``."""

from __future__ import annotations

from dataclasses import asdict

import click

from cli.ending import DONE, PARTIAL
from cli.options import json_option
from cli.output import print_json, write_line
from cli.session import TilerCommand, shown_progress
from tiler.core.words import counted


@click.command("verify", cls=TilerCommand, progress=True)
@click.argument("folder", metavar="FOLDER")
@json_option
def command(folder: str, as_json: bool) -> int:
    """Compare a delivered folder with its manifest.

    Reads every file that manifest.json lists, and prints one line for each that is missing or changed. Exit code 5 if
    there is one. Other files in the folder are listed, too.
    """
    from tiler.apps.delivery import verify

    with shown_progress() as listener:
        found = verify(folder, listener)
    if as_json:
        print_json(asdict(found))
    else:
        for state in ("missing", "changed", "extra"):
            for name in getattr(found, state):
                write_line(f"{state:9s}{name}")
        same = found.files - len(found.missing) - len(found.changed)
        write_line(f"verified {same:,} of {counted(found.files, 'file')}")
    return PARTIAL if found.missing or found.changed else DONE
