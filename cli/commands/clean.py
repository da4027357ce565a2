"""``tiler clean``."""

from __future__ import annotations

from pathlib import Path

import click

from cli.options import json_option
from cli.output import print_json, say
from cli.session import TilerCommand


@click.command("clean", cls=TilerCommand)
@click.argument("out", type=click.Path(path_type=Path), metavar="OUT")
@click.option(
    "--store",
    metavar="URL",
    help="where the store lies [default: as OUT/run.json says (without password or token of a URL), or OUT/store.zarr]",
)
@json_option
def command(out: Path, store: str | None, as_json: bool) -> None:
    """Remove what a run left behind and no later one needs.

    Scratch files of runs that were killed, the points between decoding and their buckets, older indices. The same
    command still finds everything done; with one more file it decodes again what touches it. `tiler run
    --clean-store` removes the whole store.
    """
    from tiler.apps.clean import clean

    found = clean(out, store)
    if as_json:
        print_json(found)
        return
    say(f"removed  {found['removed_objects']} objects, {found['removed_bytes'] / 1e6:,.1f} MB")
    say(f"store    {found['store_bytes'] / 1e6:,.1f} MB")
