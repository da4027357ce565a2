"""Writes ``run.json`` so that it is complete and valid at any time, also after a crash."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pyproj.exceptions import CRSError

from tiler.core.file_names import without_links
from tiler.core.words import stage_title
from tiler.errors import InputError, write_error
from tiler.io.atomic_files import write_atomic
from tiler.io.result_folder import AGAIN_WITHOUT_RUN, RUN, read_run


def write_run_file(out: Path, content: Mapping[str, Any]) -> None:
    """Replace ``OUT/run.json``, or raise ProcessingError if it cannot be written."""
    # Users read the file when the run is done. Until then it has one line, which Python writes
    # ten times as fast.
    indent = None if content["state"] == "running" else 1
    text = json.dumps(content, indent=indent, sort_keys=True) + "\n"
    write_whole(out / RUN, text.encode())


def write_whole(path: Path, content: bytes) -> None:
    """Replace a file, or raise ProcessingError if it cannot be written."""
    try:
        write_atomic(path, content)
    except OSError as error:
        raise write_error(str(path), error, path.parent) from error


def record_end(out: Path, state: str, exit_code: int) -> None:
    """Change the state in ``OUT/run.json`` in place, for a disk that has no room for a new file."""
    changes = {
        b'"state": "running"': f'"state": "{state}"',
        b'"exit_code": null': f'"exit_code": {exit_code}',
    }
    with suppress(OSError), open(out / RUN, "r+b", opener=without_links) as file:
        text = file.read()
        for before, after in changes.items():
            at = text.rfind(before)
            if at >= 0 and len(after) <= len(before):
                file.seek(at)
                file.write(after.encode().ljust(len(before)))


@contextmanager
def run_file_errors(out: Path) -> Iterator[None]:
    """Raise InputError that names ``OUT/run.json`` if its content is not what a run writes."""
    try:
        yield
    except (
        KeyError,
        TypeError,
        AttributeError,
        ValueError,
        OverflowError,
        IndexError,
        CRSError,
    ) as error:
        remedy = "run again" if read_run(str(out)) is not None else AGAIN_WITHOUT_RUN
        raise InputError(
            f"{out / RUN}: was not written by this version of tiler ({type(error).__name__}: {error}); {remedy}"
        ) from error


def units_of(run: Mapping[str, Any]) -> tuple[float, float]:
    """Return the metres in a unit of the coordinates, and in one of the heights, of a run."""
    metres = run["plan"].get("metres_per_unit", {})
    return float(metres.get("horizontal", 1.0)), float(metres.get("vertical", 1.0))


def title_of(run: Mapping[str, Any], stage: str) -> str:
    """Return the title of a stage, also for runs of versions before 0.1, whose run.json has no titles."""
    return str(run.get("stages", {}).get(stage, {}).get("title") or stage_title(stage))
