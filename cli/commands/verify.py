"""``tiler verify``."""

from __future__ import annotations

import click

from cli.ending import DONE, PARTIAL
from cli.options import json_option
from cli.output import print_result
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
    states = {"missing": found.missing, "changed": found.changed, "extra": found.extra}
    lines = [f"{state:9s}{name}" for state, names in states.items() for name in names]
    same = found.files - len(found.missing) - len(found.changed)
    verified = f"verified {same:,} of {counted(found.files, 'file')}"
    print_result(found, as_json, (*lines, verified))
    return PARTIAL if found.missing or found.changed else DONE
