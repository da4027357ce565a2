"""Finds files of OUT that are no longer as a run wrote them: gone, changed by somebody, or damaged.

Size and time tell as a rule; where the time is another one, and with ``--verify``, all bytes are read. What differs is
put aside, not overwritten: it may be somebody's work.
"""

from __future__ import annotations

from collections.abc import Mapping

from tiler.io.locations import states_at
from tiler.io.result_folder import below
from tiler.runs.job import Job
from tiler.stages.fingerprints import contents
from tiler.stages.outdated import move_aside, named

STAGE = "verify"


def take_back_spoilt(job: Job, stage: str, files: Mapping[str, str]) -> None:
    """Let the tasks of a stage be done again whose files are not what they wrote.

    Parameters
    ----------
    job : Job
    stage : str
        Its records have ``bytes``, and ``digest`` and ``state`` unless an older version made them.
    files : mapping of str to str
        Key of a task to the path or URL of its file.

    Raises
    ------
    ProcessingError
        A file that differs cannot be moved aside.
    """
    commits = {key: commit for key, commit in job.store.committed(stage).items() if key in files}
    states = dict(zip(commits, states_at([files[key] for key in commits]), strict=True))
    gone = [key for key, state in states.items() if state is None]
    there = {key: state for key, state in states.items() if state is not None}
    changed = [key for key, state in there.items() if state.size != commits[key][1]["bytes"]]
    doubtful = {}
    for key in there.keys() - set(changed):
        record = commits[key][1]
        if job.plan.config.verify or there[key].to_json() != record.get("state", there[key].to_json()):
            doubtful[files[key]] = key
    files_of = [(place, there[key], 0) for place, key in sorted(doubtful.items())]
    for place, result in contents(job, STAGE, files_of, writes_out=True):
        key = doubtful[place]
        digest, record = commits[key]
        if result.get("content") != record.get("digest", ""):
            changed.append(key)
        else:  # the same bytes: this time is as good as the one before
            job.store.commit(stage, key, digest, {**record, "state": there[key].to_json()})
    job.take_back(stage, [*gone, *changed])
    if changed:
        paths = sorted(below(job.products, files[key]) for key in changed)
        place = move_aside(job.products, paths)
        job.note(f"{named(paths)}: changed since a run wrote them; moved to {place}/ and made again")
