"""``tiler run``."""

from __future__ import annotations

from cli.job import job_command

command = job_command(
    "run",
    """The whole job: clouds to a DTM and classified clouds.

    INPUT are LAS and LAZ files, folders (with all below them), globs, virtual point clouds (.vpc) and EPT (ept.json),
    or URLs of them (s3://...). OUT gets dtm.tif and what else --products names, classified/, report.html, run.json,
    events.jsonl and the tile store. A job that was interrupted goes on where it was with the same command; a finished
    one does nothing again. Lengths are metres unless written with a unit (3ft, 50cm).
    """,
)
