"""What one call of the command line knows about itself, and the base of all commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import click


@dataclass
class Session:
    """One call of ``tiler``.

    Attributes
    ----------
    verbosity : int
        Number of -v, minus 1 for -q.
    resumes : bool
        The same command would go on where this one is interrupted.
    """

    verbosity: int = 0
    resumes: bool = False

    @property
    def quiet(self) -> bool:
        """Only warnings and errors are wanted."""
        return self.verbosity < 0


def current_session() -> Session:
    """The session of the command that runs."""
    return click.get_current_context().ensure_object(Session)


class TilerCommand(click.Command):
    """A command with -v and -q, which sets up the log before it runs."""

    def __init__(self, *arguments: Any, resumes: bool = False, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self._resumes = resumes
        self.params.extend((
            click.Option(
                ("-v", "--verbose"), count=True, expose_value=False, is_eager=True, callback=_louder,
                help="say more; -vv: everything, and tracebacks [default: progress, notes and warnings]",
            ),
            click.Option(
                ("-q", "--quiet"), is_flag=True, expose_value=False, is_eager=True, callback=_quieter,
                help="no progress, no summary: only warnings and errors [default: no]",
            ),
        ))  # fmt: skip

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; what it returns is the exit code, None is 0."""
        from tiler.observe.logs import set_up_logging

        session = ctx.ensure_object(Session)
        session.resumes = self._resumes
        set_up_logging(session.verbosity)
        return super().invoke(ctx)


def _louder(context: click.Context, parameter: click.Parameter, count: int) -> None:
    context.ensure_object(Session).verbosity += count


def _quieter(context: click.Context, parameter: click.Parameter, quiet: bool) -> None:
    context.ensure_object(Session).verbosity -= int(quiet)
