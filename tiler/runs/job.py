"""A run at work: what its stages share."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tiler.io.locations import is_url, joined, put_file
from tiler.io.result_folder import RUN, folder_here
from tiler.observe.events import Listener
from tiler.plan import Plan
from tiler.report import write_run_file
from tiler.report.notebook import run_markup
from tiler.report.sections import Settled, noted, settled, warned
from tiler.runs.compiling import Compiler
from tiler.runs.executors import Crew
from tiler.runs.record import Facts, RunRecord
from tiler.schedule import Task
from tiler.store import LEASE_SECONDS, Commits, Lease, TileStore

SAVED_SECONDS = 2.0
"""For so long run.json may not know of a stage that ended; what was done is known by the store."""


@dataclass(frozen=True)
class RunResult:
    """How a run ended; a notebook shows it with a picture of the DTM.

    Attributes
    ----------
    exit_code : int
        0, or 5 if something was left out.
    summary : dict
        What ``run.json`` says.
    did_nothing : bool
        Everything had been done before.
    out : str
        Path or URL of the results.
    """

    exit_code: int
    summary: dict[str, Any] = field(repr=False)
    did_nothing: bool
    out: str

    @property
    def files(self) -> dict[str, str]:
        """Path or URL of each file that the run wrote, or found as it would write it, by its name in OUT."""
        name = self.summary.get("report")
        report = {name: str(folder_here(self.out) / name)} if name else {}
        return report | {name: joined(self.out, name) for name in self.summary.get("outputs", {})}

    @property
    def decisions(self) -> list[Settled]:
        """What the settings became that can be left to tiler: setting, value, by whom, and why."""
        return settled(self.summary)

    @property
    def notes(self) -> list[str]:
        """What was decided or found on the way, a line each."""
        return noted(self.summary)

    @property
    def warnings(self) -> list[str]:
        """What looks wrong in the settings or the data, a line each."""
        return warned(self.summary)

    def _repr_html_(self) -> str:
        return run_markup(self.summary, self.out, self.files)


class Ownership:
    """The locks of store and OUT, looked at from time to time."""

    def __init__(self, leases: tuple[Lease, ...]) -> None:
        self._leases, self._checked = leases, time.monotonic()

    def check(self) -> None:
        """End this run if another one took store or OUT over, as after a long sleep of this machine."""
        if time.monotonic() - self._checked > LEASE_SECONDS / 2:
            for lease in self._leases:
                lease.check()
            self._checked = time.monotonic()


@dataclass
class Job:
    """A run at work: what the stages share.

    ``out`` is the folder of run.json, the log and the report; ``products``, the same or a URL, that of all other files.
    """

    plan: Plan
    out: Path
    products: str
    store: TileStore
    listener: Listener
    ownership: Ownership
    record: RunRecord = field(default_factory=RunRecord)
    crew: Crew = field(init=False)
    compiler: Compiler = field(init=False)
    _saved: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        self.compiler = Compiler(
            lambda event, facts: self.listener(event, facts), not self.plan.config.in_process
        )
        self.crew = Crew(self.plan, self.store.url, self.products, self.note)

    @property
    def facts(self) -> Facts:
        """What the stages add to run.json."""
        return self.record.facts

    def note(self, text: str) -> None:
        """Tell people what was decided for them, now and in run.json."""
        if text not in self.record.notes:  # a stage that is done again says the same again
            self.record.notes.append(text)
        self.listener("note", {"text": text})

    def sorted_out(self, stage: str, tasks: Iterable[Task]) -> tuple[Commits, Commits]:
        """Commits of a stage that hold for these tasks, and those that do not: of other settings or inputs."""
        digests = {task.key: task.digest for task in tasks}
        found = self.store.committed(stage)
        done = {key: commit for key, commit in found.items() if commit[0] == digests.get(key)}
        return done, {key: commit for key, commit in found.items() if key not in done}

    def take_back(self, stage: str, keys: Iterable[str]) -> None:
        """Tasks are done no more: always before what they wrote is overwritten or removed.

        Else a run that is killed on the way would leave commits whose data are another run's.
        """
        self.store.uncommit(stage, *keys)

    def save_on_the_way(self) -> None:
        """Write run.json unless that was done a moment ago: small stages take less time than writing it."""
        if time.monotonic() - self._saved > SAVED_SECONDS:
            self.save("running")

    def save(self, state: str) -> dict[str, Any]:
        """Write run.json and return its content."""
        self._saved = time.monotonic()
        content = self.record.content(self.plan, state)
        write_run_file(self.out, content)
        if is_url(self.products):  # a run from elsewhere knows by it whose files these are
            put_file(self.out / RUN, joined(self.products, RUN))
        return content
