"""``tiler run``, and ``ingest``, ``filter``, ``grid`` and ``export``, which end after the stage of that name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from cli.options import config_options, inputs_argument, json_option, out_option, read_config
from cli.output import print_json, write_lines
from cli.session import TilerCommand, current_session, shown_progress
from cli.summary import run_lines

RUN = """Run all stages: make a DTM and classified clouds.

INPUT are LAS and LAZ files, folders (with all their subfolders), globs, virtual point clouds (.vpc) and EPT (ept.json),
or URLs of these (s3://...). OUT gets dtm.tif, the other files of --products, classified/, report.html, run.json,
events.jsonl and the tile store. After an interruption the same command resumes. After the end it has nothing to do.
Lengths are in metres unless written with a unit (3ft, 50cm).
"""

STAGES = {
    "ingest": """First stage: read the clouds into the tile store.

Reads INPUT... (LAS and LAZ files, folders, globs) in bounded pieces and stores each point once. Give all stages the
same INPUT, OUT and options: together they are `tiler run`.
""",
    "filter": """Second stage: find the ground, tile by tile.

Completes the earlier stage first (ingest). Give all stages the same INPUT,
OUT and options: together they are `tiler run`.
""",
    "grid": """Third stage: interpolate the ground at the pixels.

Completes the earlier stages first (ingest, filter). Give all stages the same INPUT,
OUT and options: together they are `tiler run`.
""",
    "export": """Fourth stage: write the DTM and the classified clouds.

Completes the earlier stages first (ingest, filter, grid). Give all stages the same INPUT,
OUT and options: together they are `tiler run`.
""",
}


def job_command(name: str, help: str, until: str) -> click.Command:
    """Make a command that runs the job up to the end of a stage."""

    @click.command(name, cls=TilerCommand, progress=True, resumes=True, reads=True, help=help)
    @inputs_argument
    @out_option
    @config_options()
    @json_option
    def command(inputs: tuple[str, ...], out: str, as_json: bool, **settings: Any) -> int:
        config = read_config(settings)
        from tiler.preparation import prepare_workers

        # the workers import their libraries while this process imports its own
        prepare_workers(config, out)
        from tiler.apps.resolutions import run_resolutions

        with shown_progress() as listener:
            result = run_resolutions(inputs, out, config, listener, until=until)
        results = [result, *result.others]
        if as_json:
            print_json(
                {Path(one.out).name: one.summary for one in results}
                if result.others
                else result.summary
            )
        elif not current_session().quiet:
            write_lines(run_lines(results, out))
        return result.exit_code

    return command


command = job_command("run", RUN, "export")
stages = {name: job_command(name, help, name) for name, help in STAGES.items()}
