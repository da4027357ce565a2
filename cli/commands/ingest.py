"""``tiler ingest``."""

from __future__ import annotations

from cli.job import job_command

command = job_command(
    "ingest",
    """First stage: read the clouds into the tile store.

    Reads INPUT... (LAS and LAZ files, folders, globs) in bounded pieces and stores each point once. Use the
    INPUT, OUT and options of the other stages: together they are `tiler run`.
    """,
    until="ingest",
)
