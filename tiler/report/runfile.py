"""``run.json``: valid while the run works and after a crash, since each version replaces the last one whole."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from tiler.errors import ProcessingError


def write_run_file(out: Path, content: dict[str, Any]) -> None:
    """Replace ``OUT/run.json``; raises ProcessingError where it cannot be written."""
    partial = out / "run.json.partial"
    try:
        with open(partial, "w", encoding="utf-8") as stream:
            json.dump(content, stream, indent=1, sort_keys=True)
            stream.write("\n")
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(partial, out / "run.json")
    except OSError as error:
        raise ProcessingError(
            f"{out}/run.json: cannot be written ({error.strerror}); see to space and rights"
        ) from error
