"""``tiler clean``."""

from __future__ import annotations

import click

from cli.options import json_option
from cli.output import print_json, say
from cli.session import TilerCommand


@click.command("clean", cls=TilerCommand)
@click.argument("out", metavar="OUT")
@click.option(
    "--store",
    metavar="URL",
    help="where the store lies [default: as OUT/run.json says (without password or token of a URL), or OUT/store.zarr]",
)
@json_option
def command(out: str, store: str | None, as_json: bool) -> None:
    """Remove what a run left behind and no later one needs.

    Scratch files of runs that were killed, decoded points that lie sorted in the store as well, older indices. The
    same `tiler run` still finds everything done; after a file is added it decodes again what that file touches.
    `tiler run --clean-store` removes the whole store.
    """
    from tiler.apps.clean import clean

    found = clean(out, store)
    if as_json:
        print_json(found)
        return
    say(f"removed  {found['removed_objects']} objects, {found['removed_bytes'] / 1e6:,.1f} MB")
    say(f"store    {found['store_bytes'] / 1e6:,.1f} MB")
