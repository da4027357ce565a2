"""The command as a process: where it is, its arguments, its progress, and its end. Imports nothing of QGIS."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
import threading
import time
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Callable, NamedTuple

TABLE: dict[str, Any] = json.loads(Path(__file__).with_name("settings.json").read_text("utf-8"))
"""Made by ``tiler qgis install`` or ``package``."""
INTERRUPTED = 130
PARTIAL = 5
USAGE = 2
INSTALL = "python -m pip install tiler-dtm"
TEST_SECONDS = 60.0
"""For the answer to ``--version``: the first start of a newly installed command takes some seconds."""
GRACE_SECONDS = 30.0
"""After the request to end, before the process is killed; no run is harmed by that."""
POLL_SECONDS = 0.1
QGIS_OWN = (
    "PYTHONHOME",
    "PYTHONPATH",
    "PYTHONNOUSERSITE",
    "GDAL_DATA",
    "GDAL_DRIVER_PATH",
    "PROJ_LIB",
    "PROJ_DATA",
)
"""Variables by which QGIS finds its own Python and libraries, and the command would find the wrong ones."""


class CommandError(Exception):
    """What ended the command, in one line."""


class Ended(NamedTuple):
    """How a command ended.

    Attributes
    ----------
    code : int
        0, or 5: done, but something was left out or not met.
    text : str
        What it printed as its result.
    cancelled : bool
        It was asked to end.
    """

    code: int
    text: str
    cancelled: bool = False


def find_command(configured: str) -> str:
    """The path of ``tiler``: the one that is configured, else the one of PATH or of ``~/.local/bin``."""
    if configured:
        found = shutil.which(os.path.expanduser(configured))
        where = f"at {configured}"
    else:
        local = os.path.expanduser("~/.local/bin/tiler")
        found = shutil.which("tiler") or shutil.which(local)
        where = "in PATH"
    if found is None:
        raise CommandError(
            f"the command tiler is not {where}; install it ({INSTALL}), and run `tiler qgis install` "
            "or set its path under Settings > Options > Processing > Providers > tiler"
        )
    return found


def version_of(path: str) -> str:
    """Call a command to see whether it is ``tiler`` and works; its version.

    Raises
    ------
    CommandError
        With what is wrong, and what to do.
    """
    began = time.monotonic()
    ended = run_command(
        [path, "--version"], lambda event: None, lambda: time.monotonic() - began > TEST_SECONDS
    )
    if ended.cancelled:
        raise CommandError(f"{path}: did not answer within {TEST_SECONDS:.0f} s; call it in a terminal")
    words = ended.text.split()
    if len(words) < 2 or words[0].rstrip(",") != "tiler":
        raise CommandError(f"{path}: is not the command tiler; give another")
    return words[-1]


def options(spec: dict[str, Any], value: Any) -> list[str]:
    """Arguments that give a parameter this value; none where it has none or is the default, so a preset can decide.

    Parameters
    ----------
    spec : dict
        Entry of the table.
    value : bool, int, str, list or None
    """
    option = spec["option"]
    if value is None or value in ("", []) or value == spec["default"]:
        return []
    if spec["kind"] == "flag":
        return [option if value else option.replace("--", "--no-", 1)]
    if spec["kind"] == "bounds":
        return [option, *(repr(float(v)) for v in value)]
    if spec["kind"] in ("files", "texts"):
        return [part for item in value for part in (option, str(item))]
    text = ",".join(str(v) for v in value) if isinstance(value, list) else str(value)
    return [option, text] if not text.startswith("-") else [f"{option}={text}"]


def options_of_config(command: str, config: dict[str, Any]) -> list[str]:
    """Arguments that make the settings of an earlier run again, from its run.json."""
    found: list[str] = []
    for spec in TABLE["commands"][command]["parameters"]:
        key = spec["key"]
        value = config.get(key, spec["config_default"])
        if key in ("preset", "overwrite", "force") or value == spec["config_default"]:
            continue
        if key == "parameters":
            value = [f"{name}={text}" for name, text in value]
        elif spec["kind"] == "classes" and not value:
            value = "none"
        found += options({**spec, "default": None}, value)
    return found


def absolute(path: str) -> str:
    """A path that holds in any working folder; URLs stay."""
    return path if "://" in path or "::" in path else os.path.abspath(os.path.expanduser(path))


def run_command(
    arguments: list[str], tell: Callable[[dict[str, Any]], None], cancelled: Callable[[], bool]
) -> Ended:
    """Run a command to its end.

    Parameters
    ----------
    arguments : list of str
        The command and what it is called with.
    tell : callable
        Gets each object of ``--progress json``, and other lines as the ``message`` of one, in this thread.
    cancelled : callable
        Asked now and then; once it says yes the command is told to end, and waited for.

    Raises
    ------
    CommandError
        With the line that the command ended with.
    """
    with tempfile.TemporaryFile() as output:
        try:
            process = subprocess.Popen(
                arguments,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.PIPE,
                env={k: v for k, v in os.environ.items() if k not in QGIS_OWN},
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
        except OSError as error:
            raise CommandError(f"{arguments[0]}: {error.strerror or error}") from error
        try:
            last, asked = _follow(process, tell, cancelled)
        except BaseException:
            _end(process)
            raise
        output.seek(0)
        text = output.read().decode("utf-8", "replace")
    code = process.returncode
    if asked and code not in (0, PARTIAL):
        return Ended(INTERRUPTED, text, True)
    if code not in (0, PARTIAL):
        raise CommandError(
            last.removeprefix("tiler: error: ") or f"{arguments[0]} ended with code {code} and said nothing"
        )
    return Ended(code, text)


def _follow(
    process: subprocess.Popen[bytes], tell: Callable[[dict[str, Any]], None], cancelled: Callable[[], bool]
) -> tuple[str, bool]:
    """Pass on what the process says until it ends; its last error, and whether it was told to end."""
    lines: SimpleQueue[bytes | None] = SimpleQueue()
    threading.Thread(target=_read, args=(process, lines), daemon=True).start()
    last, asked = "", False
    while True:
        if not asked and cancelled():
            asked = True
            tell({"level": "info", "message": "tiler is asked to stop"})
            threading.Thread(target=_end, args=(process,), daemon=True).start()
        try:
            line = lines.get(timeout=POLL_SECONDS)
        except Empty:
            continue
        if line is None:
            break
        event = _event(line.decode("utf-8", "replace").rstrip())
        if event.get("level") == "error":
            last = str(event["message"])
        else:
            tell(event)
    process.wait()
    return last, asked


def _read(process: subprocess.Popen[bytes], lines: SimpleQueue[bytes | None]) -> None:
    if process.stderr is not None:
        with process.stderr:
            for line in process.stderr:
                lines.put(line)
    lines.put(None)


def _event(line: str) -> dict[str, Any]:
    """An object of ``--progress json``; of any other line, one with that as its message."""
    try:
        event = json.loads(line)
    except ValueError:
        event = None
    if isinstance(event, dict):
        return event
    return {"level": "error" if line.startswith("tiler: error: ") else "info", "message": line}


def _end(process: subprocess.Popen[bytes]) -> None:
    """Tell a process to end (SIGTERM, which ``tiler`` takes as Ctrl-C), and kill it if it does not."""
    process.terminate()
    try:
        process.wait(GRACE_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
