"""``tiler grid``."""

from __future__ import annotations

from cli.job import job_command

command = job_command(
    "grid",
    """Third stage: interpolate the ground at the pixels.

    Does first what is missing before it (ingest, filter). Use the INPUT, OUT and
    options of the other stages: together they are `tiler run`.
    """,
    until="grid",
)
