"""Logging to stderr, as much of it as -v and -q ask for."""

from __future__ import annotations

import logging
import sys

from tiler.observe.json_lines import json_line
from tiler.redaction import shown

_LEVELS = {-1: logging.ERROR, 0: logging.WARNING, 1: logging.INFO}
_OWN_LOGGERS = ("tiler", "ptd", "cli")


class _StderrHandler(logging.Handler):
    """Writes to whatever `sys.stderr` is at that moment: progress bars put themselves in its place."""

    def emit(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        if record.name == "py.warnings":  # several lines, the last of them source code
            text = " ".join(text.split())
        print(shown(text), file=sys.stderr, flush=True)


class _JsonHandler(_StderrHandler):
    """Writes each record as a line of ``--progress json``."""

    def emit(self, record: logging.LogRecord) -> None:
        text, level = " ".join(record.getMessage().split()), record.levelno
        name = "error" if level >= logging.ERROR else "warning" if level >= logging.WARNING else "info"
        print(json_line(text, name), file=sys.stderr, flush=True)


def set_up_logging(verbosity: int, as_json: bool = False) -> None:
    """Send the log to stderr; calling it again replaces the earlier set-up.

    Parameters
    ----------
    verbosity : int
        -1 or less: errors only; 0: warnings too; 1: what tiler decides and does; 2 or more: everything
        that tiler logs in detail, and what the libraries say (at level INFO).
    as_json : bool
        Each message is a line of ``--progress json``.
    """
    level = _LEVELS.get(max(verbosity, -1), logging.DEBUG)
    handler = _JsonHandler() if as_json else _StderrHandler()
    detailed = "%(levelname)s %(name)s: %(message)s" if verbosity >= 2 else "%(levelname)s: %(message)s"
    handler.setFormatter(logging.Formatter(detailed))
    root = logging.getLogger()
    for old in [h for h in root.handlers if isinstance(h, _StderrHandler)]:
        root.removeHandler(old)
    root.addHandler(handler)
    root.setLevel(logging.INFO if verbosity >= 2 else max(level, logging.WARNING))
    for name in _OWN_LOGGERS:
        logging.getLogger(name).setLevel(level)
    logging.captureWarnings(True)
