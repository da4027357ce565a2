"""Entry point of the command line: runs a command, and turns its errors into one line and an exit code."""

from __future__ import annotations

import gc
import importlib
import os
import re
import sys
import traceback
import warnings
from collections.abc import Sequence
from typing import Any

import click

from cli.ending import (
    DONE,
    EPILOG,
    INTERRUPTED,
    PROCESSING,
    USAGE,
    InterruptState,
    end_at_once,
    ended_in_time,
)
from cli.help import unknown_option
from cli.output import open_streams
from cli.session import Session
from tiler.errors import TilerError
from tiler.version import __version__

COMMANDS = {
    "run": "Run all stages: make a DTM and classified clouds.",
    "plan": "Show what a run would do and which resources it needs.",
    "ingest": "First stage: read the clouds into the tile store.",
    "filter": "Second stage: find the ground, tile by tile.",
    "grid": "Third stage: interpolate the ground at the pixels.",
    "export": "Fourth stage: write the DTM and the classified clouds.",
    "classify": "Classify the points of one file or of many, without a store.",
    "preview": "Draw a quick preview of the terrain for these settings.",
    "info": "Describe clouds, a store, a result folder or a raster.",
    "methods": "List the ground filters and their parameters.",
    "evaluate": "Score classes or a DTM against reference data.",
    "check": "Check a DTM by checkpoints, or clouds by a specification.",
    "report": "Update OUT/report.html with the latest measurements.",
    "review": "Write a page with a card for each of the first places to review.",
    "deliver": "Copy the results of a run into a folder with a manifest.",
    "verify": "Compare a delivered folder with its manifest.",
    "clean": "Delete temporary data that later runs do not need.",
    "simulate": "Simulate a cloud with reference classes and terrain.",
    "config": "Print the effective settings or a commented template.",
    "warm": "Compile the kernels of methods before their first run.",
    "qgis": "Install the QGIS plugin, or write it as an archive.",
    "demo": "Simulate a small city, run all stages on it, and score the result.",
}
"""First line of the help of each command, in the order of the list of commands.

It is repeated here because the list must not import all commands.
"""

GARBAGE_OBJECTS = 100_000
"""Number of new objects between two runs of the garbage collector.

Imports make little garbage, and a run after every 700 objects takes a tenth of the start of a
command.
"""

STAGES = ("ingest", "filter", "grid", "export")
"""Commands that the module of ``run`` defines."""


class LazyGroup(click.Group):
    """A group whose commands are modules of `cli.commands`, imported when they are used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """List the names of `COMMANDS`."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the command's module."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(
            f"cli.commands.{'run' if cmd_name in STAGES else cmd_name}"
        )
        command: click.Command = (
            module.stages[cmd_name] if cmd_name in STAGES else module.command
        )
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands from the table."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(
    cls=LazyGroup,
    invoke_without_command=True,
    epilog=EPILOG,
    context_settings={"max_content_width": 100},
)
@click.version_option(__version__, prog_name="tiler")
@click.pass_context
def group(context: click.Context) -> int:
    """Turn point clouds of any size into terrain models.

    `tiler run INPUT... -o OUT` runs all stages. `tiler COMMAND --help` explains a command.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help(), err=True)
        return USAGE
    return DONE


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments of the command. By default the arguments of the process.

    Returns
    -------
    int
        The exit code.
    """
    own_process = arguments is None
    if own_process:
        gc.set_threshold(GARBAGE_OBJECTS)
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with open_streams(own_process), ended_in_time(own_process) as ending:
        try:
            code = _run(arguments, ending)
        except KeyboardInterrupt:  # a signal arrived while the line of an error was written
            code = INTERRUPTED
        if own_process and code == INTERRUPTED:
            end_at_once(code)
        if own_process:
            gc.freeze()  # The interpreter then does not search all objects for garbage when it ends.
        return code


def _run(arguments: Sequence[str] | None, ending: InterruptState) -> int:
    session = Session(
        progress=_progress_asked_for(sys.argv[1:] if arguments is None else arguments)
    )
    try:
        code: Any = group.main(arguments, prog_name="tiler", standalone_mode=False, obj=session)
        sys.stdout.flush()
        return code if isinstance(code, int) else DONE
    except SystemExit:
        raise
    except BaseException as error:  # noqa: BLE001 - a decoder may panic with something that is not an Exception
        if isinstance(error, click.NoSuchOption):
            words = sys.argv[1:] if arguments is None else arguments
            error = click.UsageError(unknown_option(error, words), error.ctx)
        return _end(KeyboardInterrupt() if ending.told else error, session)


def _progress_asked_for(arguments: Sequence[str]) -> str:
    """Return ``json`` if the arguments request it, so that errors in these arguments are written as JSON, too."""
    options = [*arguments, "--"]
    words = " ".join(options[: options.index("--")])
    return "json" if re.search(r"(^| )--progress[ =]json( |$)", words) else "auto"


def _end(error: BaseException, session: Session) -> int:
    """Print the error on stderr in one line and return the exit code."""
    if session.verbosity >= 2:
        for line in "".join(traceback.format_exception(error)).splitlines():
            session.tell(line)
    if isinstance(error, KeyboardInterrupt | click.Abort):
        warnings.simplefilter("ignore")  # unfinished work warns when it is deleted
        rest = "; run the same command again to resume" if session.resumes else ""
        session.tell(f"tiler: interrupted{rest}")
        return INTERRUPTED
    text, code = _line_and_code(error)
    session.tell(f"tiler: error: {' '.join(text.split())}")
    return code


def _line_and_code(error: BaseException) -> tuple[str, int]:
    if isinstance(error, TilerError):
        return str(error), error.exit_code
    if isinstance(error, click.UsageError):
        path = error.ctx.command_path if error.ctx else "tiler"
        return f"{error.format_message().rstrip('.')}; see `{path} --help`", USAGE
    if isinstance(error, click.ClickException):
        return error.format_message(), USAGE
    text = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return (
        f"unexpected {text}; run the same command with -vv for the traceback",
        PROCESSING,
    )


if __name__ == "__main__":
    sys.exit(main())
