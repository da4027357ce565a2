"""``tiler review``."""

from __future__ import annotations

import click

from cli.options import json_option
from cli.output import print_result
from cli.session import TilerCommand
from tiler.core.words import counted
from tiler.errors import ConfigError


@click.command("review", cls=TilerCommand)
@click.argument("out", metavar="OUT")
@click.option(
    "--places",
    type=click.IntRange(1, 1000),
    default=50,
    help="largest number of places in the page, the most serious first, or of squares [default: 50]",
)
@click.option(
    "--page",
    metavar="FILE.html",
    help="file of the page [default: OUT/review.html, or OUT/statement.html]",
)
@click.option(
    "--store",
    metavar="URL",
    help="location of the store, for the points of sections [default: that in OUT/run.json, else OUT/store.zarr]",
)
@click.option(
    "--statement",
    is_flag=True,
    help="bound the area of objects left in the terrain, from random squares in OUT/statement.html [default: no]",
)
@click.option(
    "--answers",
    metavar="FILE.json",
    help="answers that the page of --statement saved [default: none]",
)
@json_option
def command(
    out: str,
    places: int,
    page: str | None,
    store: str | None,
    statement: bool,
    answers: str | None,
    as_json: bool,
) -> None:
    """Write a page with a card for each of the first places to review.

    A card shows the terrain, the terrain after the suggested edit, and a section through the
    points. Decide on each place with the mouse or the keyboard, and save the decisions in the
    page. The file is for --edits of the next run. The page needs no server and no network.

    With --statement, the page shows random squares of terrain that rises above the land around.
    You answer how much of each is an object. With the saved --answers, the command gives an
    upper bound, 95 % sure, of the area of objects of 1 m or more in height and up to 40 m in
    width that are left in the terrain.
    """
    if statement:
        _make_statement(out, places, page, store, answers, as_json)
        return
    if answers is not None:
        raise ConfigError(f"--answers {answers}: is for --statement only; add --statement")
    from tiler.apps.review import write_review_page

    written = write_review_page(out, places, page, store)
    rest = "" if written.shown == written.open else f" of {written.open:,}"
    text = f"{counted(written.shown, 'place')}{rest}" if written.open else "no place is open"
    print_result(written, as_json, [f"page  {written.page}: {text}"])


def _make_statement(
    out: str,
    places: int,
    page: str | None,
    store: str | None,
    answers: str | None,
    as_json: bool,
) -> None:
    from tiler.apps.statement import write_statement

    made = write_statement(out, places, page, store, answers)
    page_line = f"page  {made.page}: {counted(made.shown, 'square')} to answer next"
    print_result(made, as_json, (made.text, page_line) if made.page else (made.text,))
