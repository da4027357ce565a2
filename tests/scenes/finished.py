"""A run that is finished: its OUT, and what the run returned."""

from __future__ import annotations

from pathlib import Path

from tiler.pipeline import RunResult

Finished = tuple[Path, RunResult]
