"""List of the files that changed since the run before, for those who deliver them again."""

from __future__ import annotations

import json

from tiler.core.results import Changes
from tiler.core.words import counted, listed
from tiler.errors import write_error
from tiler.export.tasks.sheets import name_of
from tiler.io.atomic_files import write_atomic
from tiler.io.locations import is_url, joined, upload_file
from tiler.io.result_folder import CHANGED, REVIEW, sheet_file
from tiler.runs.found import Gridded
from tiler.runs.job import Job

NAMED = 5
"""Number of files that the note lists. Further files are counted."""


def report_changes(job: Job, gridding: Gridded) -> None:
    """Write the changes since the last run that wrote all its files, and add them to run.json.

    A run that changes nothing leaves the list of the run before.
    """
    before = dict(job.results.delivered)
    after = {path: digest for path, digest in job.results.digests.items() if path != REVIEW}
    job.results.delivered = after
    if not before:
        return
    changed = {path for path in after.keys() & before if after[path] != before[path]}
    added = after.keys() - before
    removed = before.keys() - after
    job.results.changes = changes = Changes(
        changed=sorted(changed),
        added=sorted(added),
        removed=sorted(removed),
        unchanged=len(after) - len(changed) - len(added),
        sheets=_sheets(gridding, changed | added),
    )
    if not changed and not added and not removed:
        return
    path = job.out / CHANGED
    try:
        write_atomic(path, json.dumps(changes.to_json(), indent=1).encode())
        if is_url(job.products):
            upload_file(path, joined(job.products, CHANGED))
    except OSError as error:
        raise write_error(str(path), error, job.out) from error
    number = f"{len(changed) + len(added)} of {counted(len(after), 'file')}"
    job.note(
        f"changed since the run before: {number} ({listed(sorted(changed | added), NAMED)}; {CHANGED})"
    )


def _sheets(gridding: Gridded, changed: set[str]) -> list[str]:
    """Return the names of the terrain's sheets of which one of the files changed."""
    products = gridding.plan.config.cut
    return sorted(
        name_of(gridding, "dtm", sheet)
        for sheet in gridding.sheets
        if any(sheet_file(name, name_of(gridding, name, sheet)) in changed for name in products)
    )
