"""State of a running run, and its result."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiler.core.units import in_unit_of_crs
from tiler.errors import ConfigError
from tiler.io.locations import is_url, joined, upload_file
from tiler.io.result_folder import RUN, local_folder, written_rasters
from tiler.observe.events import Detail, Listener, Note, Warned
from tiler.plan import Plan
from tiler.redaction import stored
from tiler.report.notebook import run_markup
from tiler.report.problems import Problem, problems_of
from tiler.report.runfile import write_run_file
from tiler.report.sections import ResolvedSetting, noted, settled
from tiler.runs.compiling import Compiler
from tiler.runs.executors import Executors
from tiler.runs.record import Results, RunRecord
from tiler.schedule import Task
from tiler.store import LEASE_SECONDS, Commits, Lease, TileStore

if TYPE_CHECKING:
    import xarray

SAVED_SECONDS = 2.0
"""Minimum time between two writes of run.json, since stages may be short."""
SAVE_RATIO = 20
"""Minimum ratio of the time between two writes to the duration of a write, since the file may
be long."""


@dataclass(frozen=True)
class RunResult:
    """Result of a run, which a notebook shows with a picture of the DTM.

    Attributes
    ----------
    exit_code : int
        0, or 5 if something was left out.
    summary : dict
        Content of ``run.json``.
    did_nothing : bool
        Whether earlier runs had done everything.
    out : str
        Path or URL of the results.
    plan : Plan
        Plan of the run.
    others : tuple of RunResult
        Results of the other resolutions, if several were given.
    """

    exit_code: int
    summary: dict[str, Any] = field(repr=False)
    did_nothing: bool
    out: str
    plan: Plan = field(repr=False)
    others: tuple[RunResult, ...] = field(default=(), repr=False)

    @property
    def files(self) -> dict[str, str]:
        """Path or URL of each file that the run wrote or found up to date, by its name in OUT."""
        found = {}
        report = self.summary.get("report")
        if report:
            found[report] = str(local_folder(self.out) / report)
        for name in self.summary.get("outputs", {}):
            found[name] = joined(self.out, name)
        return found

    @property
    def decisions(self) -> list[ResolvedSetting]:
        """Settings that tiler can choose, each with its value, its origin and the reason."""
        return settled(self.summary)

    @property
    def notes(self) -> list[str]:
        """Lines with the decisions and findings of the run."""
        return noted(self.summary)

    @property
    def warnings(self) -> list[str]:
        """Lines with warnings about probable errors and about omitted files and tasks."""
        return list(self.summary["warnings"])

    def dtm(self) -> xarray.DataArray:
        """Open the terrain as an array of xarray with the package rioxarray.

        Returns
        -------
        xarray.DataArray
            float32 heights in the unit of the raster, NaN where there is no height, with the CRS. The dimensions are
            (y, x) with falling y. Heights are read when they are used.

        Raises
        ------
        ConfigError
            rioxarray is not installed, or the run made no terrain.
        """
        try:
            import rioxarray
        except ImportError as error:
            raise ConfigError(
                "dtm(): needs rioxarray; run pip install 'tiler-dtm[xarray]'"
            ) from error
        name = written_rasters(self.summary).get("dtm")
        if name is None:
            raise ConfigError(f"dtm(): {self.out} has no terrain; run with the product dtm")
        opened: Any = rioxarray.open_rasterio(self.files[name], masked=True)
        array: xarray.DataArray = opened.squeeze("band", drop=True)
        return array

    def _repr_html_(self) -> str:
        return run_markup(self.summary, self.out, self.files)


class LeaseWatch:
    """Regular check of the locks of store and OUT."""

    def __init__(self, leases: tuple[Lease, ...]) -> None:
        self._leases = leases
        self._checked = time.monotonic()

    def check(self) -> None:
        """Raise LockedError if another run took over store or OUT.

        This can happen while this machine sleeps. The locks are only read if half of
        `LEASE_SECONDS` has passed since the last time.
        """
        if time.monotonic() - self._checked > LEASE_SECONDS / 2:
            for lease in self._leases:
                lease.check()
            self._checked = time.monotonic()


@dataclass
class Job:
    """State of a running run, which its stages share.

    ``out`` is the folder of run.json, log and report. ``products`` is the location of all other files, the same folder
    or a URL. ``earlier_settings`` and ``earlier_notes`` are the settings by name and the notes of the last run in OUT,
    empty without an earlier run.
    """

    plan: Plan
    out: Path
    products: str
    store: TileStore
    listener: Listener
    ownership: LeaseWatch
    record: RunRecord = field(default_factory=RunRecord)
    earlier_settings: Mapping[str, Any] = field(default_factory=dict)
    earlier_notes: Sequence[str] = ()
    executors: Executors = field(init=False)
    compiler: Compiler = field(init=False)
    _saved: float = field(init=False, default=0.0)
    _took: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        self.compiler = Compiler(
            lambda event: self.listener(event),
            not self.plan.config.in_process,
            lambda text: self.note(text, Note),
        )
        self.executors = Executors(self.plan, self.store.url, self.products, self.note)

    @property
    def results(self) -> Results:
        """Results that the stages add to run.json."""
        return self.record.results

    def note(self, text: str, kind: type[Note] | None = None) -> None:
        """Show a note to the user and add it to run.json, with lengths in the unit of the CRS.

        By default, a note that the last run has shown is a `Detail`.
        """
        text = in_unit_of_crs(text, self.plan.frame.units)
        if text not in self.record.notes:  # A stage that is run twice repeats its notes.
            self.record.notes.append(text)
        self.tell(text, kind)

    def tell(self, text: str, kind: type[Note] | None = None) -> None:
        """Show a note to the user, as `note` does, but do not add it to the notes of run.json."""
        if kind is None:
            kind = Detail if stored(text) in self.earlier_notes else Note
        self.listener(kind(text))

    def split_commits(self, stage: str, tasks: Iterable[Task]) -> tuple[Commits, Commits]:
        """Return the commits of a stage that fit these tasks, and those of other settings or inputs."""
        digests = {task.key: task.digest for task in tasks}
        done: Commits = {}
        stale: Commits = {}
        for key, commit in self.store.committed(stage).items():
            digest, _ = commit
            if digest == digests.get(key):
                done[key] = commit
            else:
                stale[key] = commit
        return done, stale

    def invalidate(self, stage: str, keys: Iterable[str]) -> None:
        """Remove the commits of tasks whose data will be overwritten or removed.

        Call it before that. Otherwise a killed run could leave commits without their data.
        """
        self.store.uncommit(stage, *keys)

    def doubt(self, text: str) -> None:
        """Warn of a doubtful decision, which is a problem of the report as well."""
        self.results.doubts = [*vars(self.results).get("doubts", ()), text]
        self.listener(Warned(text))

    def problems(self) -> list[Problem]:
        """Return the problems that the stages found until now."""
        return problems_of(self.record.content(self.plan, "running"))

    def save_if_due(self) -> None:
        """Write run.json, unless it was written a moment ago."""
        if time.monotonic() - self._saved > max(SAVED_SECONDS, SAVE_RATIO * self._took):
            self.save("running")

    def save(self, state: str) -> dict[str, Any]:
        """Write run.json and return its content."""
        began = time.monotonic()
        content = self.record.content(self.plan, state)
        write_run_file(self.out, content)
        if is_url(self.products):  # Runs on other machines read the list of files from it.
            upload_file(self.out / RUN, joined(self.products, RUN))
        self._saved = time.monotonic()
        self._took = self._saved - began
        return content
