"""Set-up of logging to stderr, with the level of detail of -v and -q."""

from __future__ import annotations

import logging
import sys

from tiler.observe.json_lines import json_line
from tiler.redaction import shown

_LEVELS = {-1: logging.ERROR, 0: logging.WARNING, 1: logging.INFO}
_OWN_LOGGERS = ("tiler", "ptd", "cli")


class _StderrHandler(logging.Handler):
    """Handler that writes to the current `sys.stderr`, which progress bars replace."""

    def emit(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        if record.name == "py.warnings":
            # The text of a Python warning has several lines, with source code at the end.
            text = " ".join(text.split())
        print(shown(text), file=sys.stderr, flush=True)


class _JsonHandler(_StderrHandler):
    """Handler that writes each record as a line of ``--progress json``."""

    def emit(self, record: logging.LogRecord) -> None:
        level = "info"
        if record.levelno >= logging.ERROR:
            level = "error"
        elif record.levelno >= logging.WARNING:
            level = "warning"
        text = " ".join(record.getMessage().split())
        print(json_line(text, level), file=sys.stderr, flush=True)


def set_up_logging(verbosity: int, as_json: bool = False) -> None:
    """Send the log to stderr. Another call replaces the set-up.

    Parameters
    ----------
    verbosity : int
        Level of detail. -1 or less shows only errors, 0 also warnings, 1 also decisions and steps of tiler, 2 or more
        also all details of tiler and messages of the libraries (from level INFO).
    as_json : bool
        Whether to write each message as a line of ``--progress json``.
    """
    level = _LEVELS.get(max(verbosity, -1), logging.DEBUG)
    handler = _JsonHandler() if as_json else _StderrHandler()
    form = (
        "%(levelname)s %(name)s: %(message)s"
        if verbosity >= 2
        else "%(levelname)s: %(message)s"
    )
    handler.setFormatter(logging.Formatter(form))
    root = logging.getLogger()
    for old in [h for h in root.handlers if isinstance(h, _StderrHandler)]:
        root.removeHandler(old)
    root.addHandler(handler)
    root.setLevel(logging.INFO if verbosity >= 2 else max(level, logging.WARNING))
    for name in _OWN_LOGGERS:
        logging.getLogger(name).setLevel(level)
    logging.captureWarnings(True)
