"""The command as a process: its path, its arguments, its progress and its end. Does not import QGIS."""

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
"""Settings of the plugin, written by ``tiler qgis install`` or ``package``."""
INTERRUPTED = 130
PARTIAL = 5
USAGE = 2
INSTALL = "python -m pip install tiler-dtm"
TEST_SECONDS = 60.0
"""Time limit of ``--version``. The first start of a newly installed command takes some
seconds."""
GRACE_SECONDS = 30.0
"""Time between the request to end and the kill of the process. A kill does not damage a run."""
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
"""Variables for the Python and libraries of QGIS. With them the command would find the wrong
ones."""


class CommandError(Exception):
    """Error that ended the command, in one line."""


class CommandResult(NamedTuple):
    """Result of a command.

    Attributes
    ----------
    code : int
        Exit code: 0, or 5 if something was left out or a requirement is not met, or 130 if the command was cancelled.
    text : str
        Text that the command printed to stdout.
    cancelled : bool
        Whether the command was asked to end.
    """

    code: int
    text: str
    cancelled: bool = False


def find_command(configured: str) -> str:
    """Return the path of ``tiler``: the configured one, else the one in ``PATH`` or in ``~/.local/bin``."""
    if configured:
        path = shutil.which(os.path.expanduser(configured))
        where = configured
    else:
        # Python before 3.12 adds no suffix to a path.
        suffix = ".exe" if os.name == "nt" else ""
        local = os.path.expanduser(os.path.join("~", ".local", "bin", f"tiler{suffix}"))
        path = shutil.which("tiler") or shutil.which(local)
        where = "PATH"
    if path is None:
        raise CommandError(
            f"{where}: the command tiler was not found; install it ({INSTALL}), then run `tiler qgis install` "
            "or set its path under Settings > Options > Processing > Providers > tiler"
        )
    return path


def version_of(path: str) -> str:
    """Check that a command is ``tiler`` and works, and return its version.

    Raises
    ------
    CommandError
        The command is not ``tiler`` or does not work.
    """
    began = time.monotonic()
    ended = run_command(
        [path, "--version"], lambda event: None, lambda: time.monotonic() - began > TEST_SECONDS
    )
    if ended.cancelled:
        raise CommandError(
            f"{path}: did not answer within {TEST_SECONDS:.0f} s; run it in a terminal to see why"
        )
    words = ended.text.split()
    if len(words) < 2 or words[0].rstrip(",") != "tiler":
        raise CommandError(f"{path} is not the command tiler; give another path")
    return words[-1]


def options(spec: dict[str, Any], value: Any) -> list[str]:
    """Return the arguments that set a parameter to a value.

    There are none if the value is empty or the default, so that a preset can decide.

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
    """Return the arguments that repeat the settings of an earlier run, from its run.json."""
    arguments: list[str] = []
    for spec in TABLE["commands"][command]["parameters"]:
        key = spec["key"]
        value = config.get(key, spec["config_default"])
        if key in ("preset", "overwrite", "force") or value == spec["config_default"]:
            continue
        if key == "parameters":
            value = [f"{name}={text}" for name, text in value]
        elif spec["kind"] == "classes" and not value:
            value = "none"
        arguments += options({**spec, "default": None}, value)
    return arguments


def raster_file(config: dict[str, Any], product: str) -> str:
    """Return the name of the file of a product, given the settings of the run from its run.json."""
    pairs = (item.partition("=") for item in (config.get("product_name") or "").split(","))
    names = {name.strip(): other.strip() for name, _, other in pairs}
    return f"{names.get(product, product)}.tif"


def absolute(path: str) -> str:
    """Return a path that is valid in every working folder, and a URL unchanged."""
    return path if "://" in path or "::" in path else os.path.abspath(os.path.expanduser(path))


def run_command(
    arguments: list[str], tell: Callable[[dict[str, Any]], None], cancelled: Callable[[], bool]
) -> CommandResult:
    """Run a command to its end.

    Parameters
    ----------
    arguments : list of str
        The command and its arguments.
    tell : callable
        Function that gets the objects of ``--progress json`` in this thread, except errors. Other lines are passed as
        the ``message`` of an object.
    cancelled : callable
        Function that is called regularly. Once it returns True, the command is asked to end, and its end is awaited.

    Raises
    ------
    CommandError
        The command failed or could not be started. The message is its last error.
    """
    with tempfile.TemporaryFile() as output:
        try:
            process = subprocess.Popen(
                arguments,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.PIPE,
                env={
                    **{k: v for k, v in os.environ.items() if k not in QGIS_OWN},
                    "PYTHONIOENCODING": "utf-8",  # Windows has other code pages.
                },
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
        return CommandResult(INTERRUPTED, text, True)
    if code not in (0, PARTIAL):
        raise CommandError(
            last.removeprefix("tiler: error: ")
            or f"{arguments[0]}: ended with code {code} and without a message; run it in a terminal to see why"
        )
    return CommandResult(code, text)


def _follow(
    process: subprocess.Popen[bytes],
    tell: Callable[[dict[str, Any]], None],
    cancelled: Callable[[], bool],
) -> tuple[str, bool]:
    """Pass on the events of a process until it ends.

    Returns its last error, and whether it was asked to end.
    """
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
    """Return the object in a line of ``--progress json``. Any other line becomes the message of an object."""
    try:
        event = json.loads(line)
    except ValueError:
        event = None
    if isinstance(event, dict):
        return event
    return {"level": "error" if line.startswith("tiler: error: ") else "info", "message": line}


def _end(process: subprocess.Popen[bytes]) -> None:
    """Ask a process to end (with SIGTERM, which ``tiler`` treats as Ctrl-C), and kill it if it does not.

    Windows kills it at once, since a process without a window cannot be asked.
    """
    process.terminate()
    try:
        process.wait(GRACE_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
