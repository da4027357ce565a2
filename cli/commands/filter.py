"""``tiler filter``."""

from __future__ import annotations

from cli.job import job_command

command = job_command(
    "filter",
    """Second stage: find the ground, tile by tile.

    Does first what is missing before it (ingest). Use the INPUT, OUT and
    options of the other stages: together they are `tiler run`.
    """,
    until="filter",
)
