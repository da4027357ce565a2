"""``tiler demo``."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import click

from cli.options import config_options, json_option, read_config
from cli.output import print_json, write_lines
from cli.session import TilerCommand, current_session, shown_progress
from cli.summary import score_lines, summary_lines

SETTINGS = (
    "method",
    "parameters",
    "tile_size",
    "halo",
    "memory",
    "workers",
    "scheduler",
    "overwrite",
    "force",
    "compress",
)


@click.command("demo", cls=TilerCommand, progress=True, resumes=True, reads=True)
@click.option(
    "-o",
    "--out",
    default="tiler-demo",
    type=click.Path(),
    metavar="OUT",
    help="folder of the results [default: tiler-demo]",
)
@click.option(
    "--seed",
    default=1,
    type=click.IntRange(min=0),
    metavar="N",
    help="seed of the simulated city; the same seed gives the same city [default: 1]",
)
@config_options(only=SETTINGS)
@json_option
def command(out: str, seed: int, as_json: bool, **settings: Any) -> int:
    """Simulate a small city, run all stages on it, and score the result.

    Writes the clouds of the city with reference classes and terrain to OUT/input, and the
    results of `tiler run` to OUT. Prints the errors of the classes and of the DTM.
    """
    config = read_config(settings)
    from tiler.preparation import prepare_workers

    # The workers import their libraries while this process simulates.
    prepare_workers(config, out)
    from tiler.apps.demo import run_demo

    with shown_progress() as listener:
        result = run_demo(out, seed, config, listener)
    if as_json:
        print_json(asdict(result))
    elif not current_session().quiet:
        write_lines(summary_lines(result.summary, out))
        write_lines(score_lines(result.classes, result.dtm))
    return result.exit_code
