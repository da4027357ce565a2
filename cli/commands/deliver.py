"""``tiler deliver``."""

from __future__ import annotations

import click

from cli.ending import DONE, PARTIAL
from cli.options import json_option
from cli.output import print_result
from cli.session import TilerCommand, shown_progress
from tiler.core.words import counted, listed
from tiler.observe.progress import size_text

MAX_LEFT = 20
"""Number of files that the line of files left names. Further files are counted."""


@click.command("deliver", cls=TilerCommand, progress=True)
@click.argument("out", metavar="OUT")
@click.option("--to", metavar="FOLDER", required=True, help="folder of the delivery")
@json_option
def command(out: str, to: str, as_json: bool) -> int:
    """Copy the results of a run into a folder with a manifest.

    The folder gets the rasters, clouds and vector files of OUT, the report, and index.html, a page
    for the client. Each file is compared with what the run wrote. The store and the places to
    review are not delivered. manifest.json has the SHA-256 and the facts of each file. Deliver to
    the same folder again after a later run: changed files are replaced, and files that are not
    delivered any more are removed. One line names the files that no delivery wrote or somebody
    changed, which are left. Exit code 5 if the run left something out.
    """
    from tiler.apps.delivery import deliver

    with shown_progress() as listener:
        made = deliver(out, to, listener)
    lines = [f"delivered  {counted(made.files, 'file')}, {size_text(made.bytes)}, to {to}"]
    lines += [f"removed    {name}, which this run does not deliver" for name in made.removed]
    if made.left:
        lines.append(
            f"left       {listed(made.left, MAX_LEFT, 'files')}, changed or not of a delivery"
        )
    if not made.complete:
        lines.append("incomplete the run left something out, see the report")
    print_result(made, as_json, lines)
    return DONE if made.complete else PARTIAL
