"""The command line, patient and with tiles that wait: it cannot be done before a test has hit it, whatever the load."""

from __future__ import annotations

import sys
from pathlib import Path

from cli import ending
from cli.main import main
from tests.integration.deadly import HOLD, held_tile
from tests.waiting import PATIENCE_SECONDS
from tiler.filter.tasks import passes
from tiler.schedule import workers


def hold(out: Path) -> None:
    """Let all tiles but one wait, of runs with this OUT that `held` starts."""
    (out.parent / HOLD).touch()


def held(*arguments: object) -> list[str]:
    """As `tests.integration.command.command`."""
    return [sys.executable, "-m", "tests.integration.held", *map(str, arguments)]


if __name__ == "__main__":
    passes.filter_tile = held_tile  # type: ignore[attr-defined]
    ending.GRACE_SECONDS = PATIENCE_SECONDS
    workers.CONNECT_SECONDS = 10  # of 20: how long a scheduler that is gone is looked for
    sys.exit(main())
