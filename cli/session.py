"""State of one call of the command line (verbosity, progress), and the base class of all commands."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from cli.help import MANY, abbreviations, help_all_option, repeated_options, write_options
from cli.output import write_line

if TYPE_CHECKING:
    from tiler.observe.events import Listener

_ABBREVIATIONS = "tiler.abbreviations"


@dataclass
class Session:
    """State of one call of ``tiler``.

    Attributes
    ----------
    verbosity : int
        Number of -v, minus 1 for -q.
    resumes : bool
        Whether the same command would resume after an interruption.
    progress : {"auto", "plain", "json", "none"}
        Form of the progress. With ``json`` every line on stderr is JSON.
    """

    verbosity: int = 0
    resumes: bool = False
    progress: str = "auto"

    @property
    def quiet(self) -> bool:
        """Whether only warnings and errors are shown."""
        return self.verbosity < 0

    def tell(self, line: str, level: str = "error") -> None:
        """Write a line to stderr, as JSON if the progress is JSON."""
        if self.progress == "json":
            from tiler.observe.json_lines import json_line

            line = json_line(line, level)
        write_line(line, error=True)


def current_session() -> Session:
    """Return the session of the running command."""
    return click.get_current_context().ensure_object(Session)


@contextmanager
def shown_progress() -> Iterator[Listener]:
    """Yield the listener that shows the progress of the running command in the form that its options select."""
    from tiler.observe.progress import open_progress

    session = current_session()
    verbose = session.verbosity > 0
    with open_progress(sys.stderr, session.quiet, session.progress, verbose) as listener:
        yield listener


class TilerCommand(click.Command):
    """Command with -v and -q, and with --progress if it shows progress.

    It sets up the log before it runs. If it ``reads`` clouds, the child process that inspects
    them imports its libraries while the command imports its own.
    """

    def __init__(
        self,
        *arguments: Any,
        resumes: bool = False,
        progress: bool = False,
        reads: bool = False,
        **settings: Any,
    ) -> None:
        super().__init__(*arguments, **settings)
        self._resumes, self._reads = resumes, reads
        if progress:
            self._add(
                "--progress",
                callback=_set_progress,
                type=click.Choice(("auto", "plain", "json", "none")),
                default="auto",
                help="form of the progress on stderr: bars on a terminal and notes and warnings elsewhere (auto), "
                "lines about the stages as well (plain), a JSON object per line (json), or none [default: auto]",
            )
        said = "print more; -vv: everything, and tracebacks [default: progress, notes and warnings]"
        self._add("-v", "--verbose", callback=_louder, count=True, help=said)
        said = "print only warnings and errors, no progress and no summary [default: no]"
        self._add("-q", "--quiet", callback=_quieter, is_flag=True, help=said)
        self._has_many = len(self.params) >= MANY
        if self._has_many:
            self.params.append(help_all_option())

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, in groups if there are many."""
        if self._has_many:
            write_options(ctx, self.get_params(ctx), formatter)
        else:
            super().format_options(ctx, formatter)

    def _add(self, *names: str, **settings: Any) -> None:
        """Add an option that changes the session and is not passed to the command."""
        self.params.append(click.Option(names, expose_value=False, is_eager=True, **settings))

    def make_parser(self, ctx: click.Context) -> Any:
        """Make a parser that also knows the abbreviations of options in `_ABBREVIATIONS`."""
        parser = super().make_parser(ctx)
        found: dict[str, str] = ctx.meta.get(_ABBREVIATIONS, {})
        for option in self.get_params(ctx):
            names = option.opts, option.secondary_opts
            more = [[word for word, name in found.items() if name in some] for some in names]
            if any(more):
                option.opts, option.secondary_opts = (
                    [*n, *m] for n, m in zip(names, more, strict=True)
                )
                option.add_to_parser(parser, ctx)
                option.opts, option.secondary_opts = names
        return parser

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments, and warn of options that are given twice."""
        ctx.meta[_ABBREVIATIONS] = abbreviations(args, self.get_params(ctx))
        *_, given = self.make_parser(ctx).parse_args(list(args))
        rest = super().parse_args(ctx, args)
        for name in repeated_options(given):
            text = f"warning: {name} is given more than once; the last value counts"
            ctx.ensure_object(Session).tell(text, "warning")
        return rest

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command, and return its exit code, or None for 0."""
        from tiler.io.proj_database import validate_proj_database
        from tiler.observe.json_lines import set_up_logging

        session = ctx.ensure_object(Session)
        session.resumes = self._resumes
        set_up_logging(session.verbosity, as_json=session.progress == "json")
        validate_proj_database()
        from tiler.preparation import import_reading
        from tiler.schedule import fork_server_running, prepare_children

        with fork_server_running():  # All children of the command share the imports.
            if self._reads and not ctx.params.get("in_process"):
                prepare_children(import_reading)
            return super().invoke(ctx)


def _louder(context: click.Context, parameter: click.Parameter, count: int) -> None:
    context.ensure_object(Session).verbosity += count


def _set_progress(context: click.Context, parameter: click.Parameter, form: str) -> None:
    context.ensure_object(Session).progress = form


def _quieter(context: click.Context, parameter: click.Parameter, quiet: bool) -> None:
    context.ensure_object(Session).verbosity -= int(quiet)
