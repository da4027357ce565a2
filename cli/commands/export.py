"""``tiler export``."""

from __future__ import annotations

from cli.job import job_command

command = job_command(
    "export",
    """Fourth stage: write the DTM and the classified clouds.

    Does first what is missing before it (ingest, filter, grid). Use the INPUT, OUT and
    options of the other stages: together they are `tiler run`.
    """,
    until="export",
)
