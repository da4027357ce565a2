"""``tiler report``."""

from __future__ import annotations

import click

from cli.output import write_line
from cli.session import TilerCommand


@click.command("report", cls=TilerCommand)
@click.argument("out", metavar="OUT")
@click.option(
    "--title",
    metavar="TEXT",
    help='heading of the report, also of later ones; "" gives the default [default: "Terrain of" and the name of OUT]',
)
def command(out: str, title: str | None) -> None:
    """Update OUT/report.html with the latest measurements.

    Every run and `tiler check OUT` write the report. Update it after an interruption and after
    other measurements: it shows the content of OUT/check.json and OUT/evaluate.json (`tiler
    evaluate ... --json > OUT/evaluate.json`). The report is one file that loads no other files,
    so you can send or print it. If OUT is a URL, the report is
    written in the local folder of the same name and copied to OUT. The two JSON files belong in
    that local folder, too.
    """
    from tiler.report.html import write_report_at

    write_line(write_report_at(out, title))
