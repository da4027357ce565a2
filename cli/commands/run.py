"""``tiler run``, and its four stages: ``ingest``, ``filter``, ``grid`` and ``export`` do the job up to their end."""

from __future__ import annotations

import os
from typing import Any

import click

from cli.options import config_options, inputs_argument, json_option, out_option, read_config
from cli.output import print_json, say
from cli.session import READING, TilerCommand, current_session, shown_progress
from cli.summary import summary_lines

RUN = """The whole job: clouds to a DTM and classified clouds.

INPUT are LAS and LAZ files, folders (with all below them), globs, virtual point clouds (.vpc) and EPT (ept.json),
or URLs of them (s3://...). OUT gets dtm.tif and what else --products names, classified/, report.html, run.json,
events.jsonl and the tile store. A job that was interrupted goes on where it was with the same command; a finished
one does nothing again. Lengths are metres unless written with a unit (3ft, 50cm).
"""

STAGES = {
    "ingest": """First stage: read the clouds into the tile store.

Reads INPUT... (LAS and LAZ files, folders, globs) in bounded pieces and stores each point once. Use the
INPUT, OUT and options of the other stages: together they are `tiler run`.
""",
    "filter": """Second stage: find the ground, tile by tile.

Does first what is missing before it (ingest). Use the INPUT, OUT and
options of the other stages: together they are `tiler run`.
""",
    "grid": """Third stage: interpolate the ground at the pixels.

Does first what is missing before it (ingest, filter). Use the INPUT, OUT and
options of the other stages: together they are `tiler run`.
""",
    "export": """Fourth stage: write the DTM and the classified clouds.

Does first what is missing before it (ingest, filter, grid). Use the INPUT, OUT and
options of the other stages: together they are `tiler run`.
""",
}


def job_command(name: str, help: str, until: str) -> click.Command:
    """A command that runs the job of INPUT... and OUT to the end of a stage."""

    @click.command(name, cls=TilerCommand, progress=True, resumes=True, reads=READING, help=help)
    @inputs_argument
    @out_option
    @config_options()
    @json_option
    def command(inputs: tuple[str, ...], out: str, as_json: bool, **settings: Any) -> int:
        config = read_config(settings)
        from tiler.io.result_folder import STORE
        from tiler.schedule import WORKING, prepare_children

        if not (config.in_process or os.path.exists(config.store or os.path.join(out, STORE))):
            prepare_children(*WORKING)  # while this process imports the same
        from tiler.pipeline import run

        session = current_session()
        with shown_progress() as listener:
            result = run(inputs, out, config, listener, until=until)
        if as_json:
            print_json(result.summary)
        elif not session.quiet:
            for line in summary_lines(result.summary, out, result.did_nothing):
                say(line)
        return result.exit_code

    return command


command = job_command("run", RUN, "export")
stages = {name: job_command(name, help, name) for name, help in STAGES.items()}
