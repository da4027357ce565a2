"""Kernels that are compiled before and during a run."""

from __future__ import annotations

import dataclasses
import errno
import functools
from collections.abc import Callable
from pathlib import Path

import pytest

from ptd.matched.evidence import Evidence
from ptd.precompile import is_compiled
from tests.tiler.conftest import MakeCloud
from tests.tiler.plans import changed
from tests.tiler.schedule import calls
from tiler.config import RunConfig
from tiler.observe.events import Event, Note, StageFinished, StageStarted, Warned
from tiler.plan import make_plan
from tiler.runs import compiling
from tiler.runs.compiling import CLASS_KERNELS, Compiler, Kernels, class_kernels, likely_kind


def make_file(path: Path, tell: Callable[[], None]) -> None:
    """Stands for compiling."""
    path.touch()


def crash(tell: Callable[[], None]) -> None:
    calls.crash()


def fill_disk(tell: Callable[[], None]) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Event]:
    """Events; files in a folder of the test show that kernels are compiled, and other processes do not count."""
    monkeypatch.setattr(compiling, "is_compiled", lambda name: Path(name).exists())
    monkeypatch.setattr(compiling, "compiled_count", lambda: 0)
    return []


def compiler(told: list[Event]) -> Compiler:
    def note(text: str) -> None:
        told.append(Note(text))

    return Compiler(told.append, apart=True, note=note)


def test_a_run_waits_for_its_kernels(told: list[Event], tmp_path: Path) -> None:
    """Kernels are compiled once, in a process of their own."""
    done = tmp_path / "done"
    kernels, at_work = Kernels(str(done), functools.partial(make_file, done), 1), compiler(told)
    for _ in range(2):
        at_work.finish(kernels)
    at_work.close()
    assert done.exists()
    why, started, finished = told
    assert isinstance(why, Note)
    assert why.text.startswith("kernels are compiled")
    assert started == StageStarted("compile", "compile kernels", tasks=1)
    assert isinstance(finished, StageFinished)


@pytest.mark.parametrize(
    ("work", "why"),
    [
        (crash, f"the process {calls.CRASHED}"),
        (fill_disk, "OSError: [Errno 28] No space left on device"),
    ],
)
def test_a_failed_compilation_is_reported(
    work: Callable[[Callable[[], None]], None],
    why: str,
    told: list[Event],
    tmp_path: Path,
) -> None:
    at_work, name = compiler(told), str(tmp_path / "never")
    at_work.finish(Kernels(name, work, 1))
    at_work.close()
    text = f"kernels ({name}) could not be compiled in advance ({why}), so each process compiles them itself"
    assert told[-1] == Warned(text)


def test_the_kind_of_a_cloud_is_guessed(make_cloud: MakeCloud) -> None:
    """Single returns prove nothing, so the evidence decides, or a setting."""
    path = str(make_cloud())
    assert likely_kind(make_plan([path], RunConfig(kind="als", in_process=True))) == "lidar"
    assert likely_kind(make_plan([path], RunConfig(kind="dim", in_process=True))) == "dim"
    plan = make_plan([path], RunConfig(in_process=True))
    single = tuple(dataclasses.replace(source, returns=1) for source in plan.inputs.sources)
    plan = changed(plan, sources=single, covered_m2=1.0, kind=None)
    no_trace, measured = (
        Evidence(trace=0.0),
        Evidence(own_intensity=1.0, grey_intensity=0.0, colour=1.0),
    )
    for evidence, kind in ((Evidence(), "dim"), (no_trace, "dim"), (measured, "lidar")):
        assert likely_kind(changed(plan, evidence=evidence)) == kind


@pytest.mark.parametrize(
    ("name", "point_format", "settings", "needed"),
    [
        ("a.laz", 7, {}, True),
        ("a.laz", 7, {"classified": "las"}, False),
        ("a.laz", 7, {"classified": "none"}, False),
        ("a.laz", 3, {}, False),
        ("a.las", 7, {}, False),
    ],
)
def test_classes_of_layered_laz_need_kernels(
    make_cloud: MakeCloud,
    name: str,
    point_format: int,
    settings: dict[str, str],
    needed: bool,
) -> None:
    path = str(make_cloud(name, point_format=point_format, version="1.4"))
    plan = make_plan([path], RunConfig(in_process=True, **settings))
    assert class_kernels(plan) == (CLASS_KERNELS if needed else None)
    CLASS_KERNELS.compile(lambda: None)
    assert is_compiled(CLASS_KERNELS.name)
