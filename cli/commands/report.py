"""``tiler report``."""

from __future__ import annotations

import click

from cli.output import say
from cli.session import TilerCommand


@click.command("report", cls=TilerCommand)
@click.argument("out", metavar="OUT")
def command(out: str) -> None:
    """Draw OUT/report.html again, with what was measured since.

    Every run draws it. Do so again after an interruption, and after measuring: the report shows what OUT/check.json
    and OUT/evaluate.json hold (`tiler check ... --json > OUT/check.json`, `tiler evaluate ... --json >
    OUT/evaluate.json`). One file, which loads nothing: send it, or print it. Where OUT is a URL, it is drawn in the
    folder here of the same name, which also holds these two, and copied to OUT.
    """
    from tiler.report.html import write_report_at

    say(write_report_at(out))
