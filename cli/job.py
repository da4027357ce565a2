"""Shared by `run` and the four stage commands: each does the whole job up to one stage."""

from __future__ import annotations

from typing import Any

import click

from cli.options import config_options, inputs_argument, json_option, out_option, read_config
from cli.output import print_json, say
from cli.session import TilerCommand, current_session, shown_progress
from cli.summary import summary_lines


def job_command(name: str, help: str, until: str = "export") -> click.Command:
    """A command that runs the job of INPUT... and OUT, to the end or to the end of a stage."""

    @click.command(name, cls=TilerCommand, progress=True, resumes=True, help=help)
    @inputs_argument
    @out_option
    @config_options()
    @json_option
    def command(inputs: tuple[str, ...], out: str, as_json: bool, **settings: Any) -> int:
        config = read_config(settings)
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
