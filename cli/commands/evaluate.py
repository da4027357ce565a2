"""``tiler evaluate``."""

from __future__ import annotations

import click

from cli.options import json_option
from cli.output import print_json
from cli.session import TilerCommand
from cli.summary import score_lines
from tiler.config import parse_classes


@click.command("evaluate", cls=TilerCommand)
@click.argument("cloud", metavar="CLOUD", type=click.Path())
@click.option(
    "--reference", required=True, metavar="REF", type=click.Path(),
    help="cloud of the same points with the true classes",
)  # fmt: skip
@click.option(
    "--ignore",
    metavar="N,N,...",
    help="true classes that do not count [default: 7,9,17,18,26,64,65,66,67: noise, water, bridges, virtual points]",
)
@json_option
def command(cloud: str, reference: str, ignore: str | None, as_json: bool) -> None:
    """Score a cloud's classes against a reference.

    Class 2 is ground, every other class is not. Type I: ground that was lost; type II: objects that were taken
    for ground; total: both, of all points; kappa: Cohen's.
    """
    ignored = None if ignore is None else parse_classes(ignore)
    from tiler.evaluate import IGNORED, evaluate_files

    facts = evaluate_files(cloud, reference, IGNORED if ignored is None else ignored)
    if as_json:
        print_json(facts)
    else:
        for line in score_lines(facts):
            click.echo(line)
