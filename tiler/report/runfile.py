"""Writes ``run.json`` so that it is whole and valid at any time, also after a crash."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tiler.core.stage_names import stage_title
from tiler.errors import ConfigError, refused_write
from tiler.io.json_text import read_object
from tiler.io.partial_files import write_whole
from tiler.io.result_folder import RUN


def write_run_file(out: Path, content: dict[str, Any]) -> None:
    """Replace ``OUT/run.json``; raises ProcessingError where it cannot be written."""
    text = json.dumps(content, indent=1, sort_keys=True) + "\n"
    try:
        write_whole(out / RUN, text.encode())
    except OSError as error:
        raise refused_write(f"{out}/{RUN}", error, out) from error


def earlier_statistics(out: Path, method: str, parameters: dict[str, Any]) -> dict[str, Any]:
    """State after each pass of a run that was done in ``out`` with the same method.

    Raises
    ------
    ConfigError
        There is no such run, it was not finished, or its method or parameters are others.
    """
    try:
        found = read_object((out / RUN).read_text(encoding="utf-8"))
        before, statistics, state = found["plan"], dict(found["statistics"]), found["state"]
        same = (before["method"], before["parameters"]) == (method, parameters)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"--statistics {out}: holds no run.json of a finished run; name an OUT folder"
        ) from error
    if state != "done":
        raise ConfigError(f"--statistics {out}: that run is not finished; run it to its end first")
    if not same:
        raise ConfigError(
            f"--statistics {out}: that run used {before['method']} with other parameters or another method; "
            "use the same --method and --set"
        )
    return statistics


def title_of(run: Mapping[str, Any], stage: str) -> str:
    """A stage of a run in words; a run of before 0.1 does not say what its passes do."""
    return str(run.get("stages", {}).get(stage, {}).get("title") or stage_title(stage))
