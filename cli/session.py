"""State of one call of the command line (verbosity, listeners), and the base class of all commands."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from tiler.observe.events import Listener

READING = ("tiler.ingest.sources",)
"""What a process needs that looks into clouds."""


@dataclass
class Session:
    """One call of ``tiler``.

    Attributes
    ----------
    verbosity : int
        Number of -v, minus 1 for -q.
    resumes : bool
        The same command would go on where this one is interrupted.
    progress : {"auto", "plain", "json", "none"}
        How progress is shown; with ``json`` all that goes to stderr is.
    """

    verbosity: int = 0
    resumes: bool = False
    progress: str = "auto"

    @property
    def quiet(self) -> bool:
        """Only warnings and errors are wanted."""
        return self.verbosity < 0


def current_session() -> Session:
    """The session of the command that runs."""
    return click.get_current_context().ensure_object(Session)


@contextmanager
def shown_progress() -> Iterator[Listener]:
    """The listener that shows the progress of the command that runs as its options ask for."""
    from tiler.observe.progress import open_progress

    session = current_session()
    with open_progress(sys.stderr, session.quiet, session.progress) as listener:
        yield listener


class TilerCommand(click.Command):
    """A command with -v and -q, and with --progress where it shows some, which sets up the log before it runs.

    What looks into clouds for one that ``reads`` some starts beside it, and imports what is named there while the
    command imports its own libraries.
    """

    def __init__(
        self,
        *arguments: Any,
        resumes: bool = False,
        progress: bool = False,
        reads: Sequence[str] = (),
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
                help="on stderr: bars on a terminal and lines elsewhere (auto), lines, a JSON object a line, or "
                "none [default: auto]",
            )
        said = "say more; -vv: everything, and tracebacks [default: progress, notes and warnings]"
        self._add("-v", "--verbose", callback=_louder, count=True, help=said)
        said = "no progress, no summary: only warnings and errors [default: no]"
        self._add("-q", "--quiet", callback=_quieter, is_flag=True, help=said)

    def _add(self, *names: str, **settings: Any) -> None:
        """Add an option that changes the session and that the command does not get to see."""
        self.params.append(click.Option(names, expose_value=False, is_eager=True, **settings))

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; what it returns is the exit code, None is 0."""
        from tiler.observe.logs import set_up_logging

        session = ctx.ensure_object(Session)
        session.resumes = self._resumes
        set_up_logging(session.verbosity, as_json=session.progress == "json")
        if not self._reads or ctx.params.get("in_process"):
            return super().invoke(ctx)
        from tiler.schedule import kept_forking, prepare_children

        with kept_forking():
            prepare_children(*self._reads)
            return super().invoke(ctx)


def _louder(context: click.Context, parameter: click.Parameter, count: int) -> None:
    context.ensure_object(Session).verbosity += count


def _set_progress(context: click.Context, parameter: click.Parameter, form: str) -> None:
    context.ensure_object(Session).progress = form


def _quieter(context: click.Context, parameter: click.Parameter, quiet: bool) -> None:
    context.ensure_object(Session).verbosity -= int(quiet)
