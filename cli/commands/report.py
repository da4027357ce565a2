"""``tiler report``."""

from __future__ import annotations

from pathlib import Path

import click

from cli.output import say
from cli.session import TilerCommand


@click.command("report", cls=TilerCommand)
@click.argument("out", metavar="OUT", type=click.Path(path_type=Path))
def command(out: Path) -> None:
    """Draw OUT/report.html again, with what was measured since.

    Every run draws it. Do so again after an interruption, and after measuring: the report shows what OUT/check.json
    and OUT/evaluate.json hold (`tiler check ... --json > OUT/check.json`, `tiler evaluate ... --json >
    OUT/evaluate.json`). One file, which loads nothing: send it, or print it.
    """
    from tiler.report.html import write_report

    say(str(write_report(out)))
