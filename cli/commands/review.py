"""``tiler review``."""

from __future__ import annotations

from dataclasses import asdict

import click

from cli.options import json_option
from cli.output import print_json, write_line
from cli.session import TilerCommand
from tiler.core.words import counted


@click.command("review", cls=TilerCommand)
@click.argument("out", metavar="OUT")
@click.option(
    "--places",
    type=click.IntRange(1, 1000),
    default=50,
    help="largest number of places in the page, the most serious first [default: 50]",
)
@click.option(
    "--page",
    metavar="FILE.html",
    help="file of the page [default: OUT/review.html]",
)
@click.option(
    "--store",
    metavar="URL",
    help="location of the store, for the points of sections [default: that in OUT/run.json, else OUT/store.zarr]",
)
@json_option
def command(out: str, places: int, page: str | None, store: str | None, as_json: bool) -> None:
    """Write a page with a card for each of the first places to review.

    A card shows the terrain, the terrain after the suggested edit, and a section through the
    points. Decide on each place with the mouse or the keyboard, and save the decisions in the
    page. The file is for --edits of the next run. The page needs no server and no network.
    """
    from tiler.apps.review import write_review_page

    written = write_review_page(out, places, page, store)
    if as_json:
        print_json(asdict(written))
    elif not written.page:
        write_line("no place is open, so there is no page")
    else:
        rest = "" if written.shown == written.open else f" of {written.open:,}"
        write_line(f"page  {written.page}: {counted(written.shown, 'place')}{rest}")
