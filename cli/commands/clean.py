"""``tiler clean``."""

from __future__ import annotations

import click

from cli.options import json_option
from cli.output import print_result
from cli.session import TilerCommand


@click.command("clean", cls=TilerCommand)
@click.argument("out", metavar="OUT")
@click.option(
    "--store",
    metavar="URL",
    help="location of the store [default: the store in OUT/run.json (its URL has no password or token there), else "
    "OUT/store.zarr]",
)
@json_option
def command(out: str, store: str | None, as_json: bool) -> None:
    """Delete temporary data that later runs do not need.

    Removes scratch files of killed runs, decoded points that the store also contains in sorted
    form, and outdated indices. Afterwards the same `tiler run` still has nothing to do. If you
    add a file, a run decodes the files that overlap it once more. `tiler run --clean-store`
    removes the whole store.
    """
    from tiler.apps.clean import clean

    cleaned = clean(out, store)
    lines = (
        f"removed  {cleaned.removed_objects} objects, {cleaned.removed_bytes / 1e6:,.1f} MB",
        f"store    {cleaned.store_bytes / 1e6:,.1f} MB",
    )
    print_result(cleaned, as_json, lines)
