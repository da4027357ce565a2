"""``tiler plan``."""

from __future__ import annotations

from typing import Any

import click

from cli.options import config_options, inputs_argument, json_option, read_config
from cli.output import print_json, write_line, write_lines
from cli.session import TilerCommand


@click.command("plan", cls=TilerCommand, reads=True)
@inputs_argument
@click.option(
    "-o",
    "--out",
    metavar="OUT",
    help="folder of the run, to check its disk, its existing files and the access of workers [default: none]",
)
@config_options()
@json_option
def command(inputs: tuple[str, ...], out: str | None, as_json: bool, **settings: Any) -> None:
    """Show what a run would do and which resources it needs.

    Prints the points, tiles, memory, disk space and time of `tiler run` with the same INPUT and
    options. It reads the headers of the files and a few thousand points of each, and writes
    nothing. If a run would end with an error before its first stage, the plan ends with the
    same error. With --scheduler it also checks the versions and memory of the workers and their
    access to INPUT. With -o or --store it then checks whether they can write there: they write
    an empty file, which is removed at once.
    """
    config = read_config(settings)
    from tiler.apps.resolutions import plan_resolutions
    from tiler.io.locations import joined
    from tiler.io.result_folder import STORE
    from tiler.plan import plan_json, plan_lines, projected_memory

    plans = plan_resolutions(inputs, config, out)
    plan, *others = plans.values()
    cluster = None
    if config.scheduler is not None:
        from tiler.runs.executors import look_at_cluster

        store = config.store or (None if out is None else joined(out, STORE))
        plan, cluster = look_at_cluster(plan, store, out)
    if as_json:
        content = plan_json(plan) | ({} if cluster is None else {"cluster": cluster.to_json()})
        print_json(
            {name: plan_json(each) for name, each in plans.items()} if others else content
        )
        return
    for name, each in plans.items():
        if others:
            write_line(f"resolution  {name}")
        write_lines(plan_lines(each))
    if cluster is not None:
        write_lines(cluster.lines(max(projected_memory(plan).values())))
