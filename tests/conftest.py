"""Fixtures that all tests share."""

from __future__ import annotations

import gc
import logging
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

TESTS = Path(__file__).resolve().parent
COMPILE_FIRST = "ptd/test_precompile.py"
COMPILE_NOTHING = tuple(
    f"{folder}/"
    for folder in (
        "cli",
        "tiler/apps/check",
        "tiler/core",
        "tiler/export",
        "tiler/io",
        "tiler/observe",
        "tiler/config",
        "tiler/report",
        "tiler/schedule",
        "tiler/store",
    )
)
OBJECTS_BETWEEN_COLLECTIONS = 50_000
"""Python's own 700 are meant for small programs."""
SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

# The same examples on every run, however slow the machine: what fails in CI fails at home.
settings.register_profile(
    "tests",
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
# Other examples each time: `pytest --hypothesis-profile=explore`. What it finds becomes an
# `@example` of its test.
settings.register_profile(
    "explore", settings.get_profile("tests"), derandomize=False, print_blob=True
)
settings.load_profile("tests")


def _link_or_skip(link: Path, target: str | Path, target_is_directory: bool = False) -> None:
    """Make a link, or skip the test: Windows lets only some users make links, and its emulation makes none."""
    try:
        os.symlink(target, link, target_is_directory)
    except OSError as error:
        pytest.skip(f"no links: {error.strerror}")
    if not link.is_symlink():
        pytest.skip("no links: none was made")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Iterator[None]:
    """Skip a test that needs links where there are none."""
    with pytest.MonkeyPatch.context() as patches:
        if os.name == "nt":
            patches.setattr(Path, "symlink_to", _link_or_skip)
        return (yield)


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Let the processes of a test take SIGINT: a script's background, in which the tests may run, ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def logging_as_before() -> Iterator[None]:
    """Take back what a command sets up."""
    root, own = logging.getLogger(), [logging.getLogger(n) for n in ("tiler", "ptd", "cli")]
    handlers, level = root.handlers[:], root.level
    yield
    logging.captureWarnings(False)
    root.handlers[:] = handlers
    root.setLevel(level)
    for logger in own:
        logger.setLevel(logging.NOTSET)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real clouds beside the repository; skips where it is absent."""
    if not SHARED_DATA.is_dir():
        pytest.skip("no real clouds: ../shared/data is absent")
    return SHARED_DATA


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Order the tests, and let those that start processes run again once.

    Kernels compile in one of the processes, while another does what needs none; all others find
    them compiled.
    """

    def turn(item: pytest.Item) -> int:
        path = item.path.relative_to(TESTS).as_posix()
        return 0 if path == COMPILE_FIRST else 1 if path.startswith(COMPILE_NOTHING) else 2

    items.sort(key=turn)
    for item in items:
        if item.get_closest_marker("processes"):
            item.add_marker(pytest.mark.flaky(reruns=1))


def pytest_collection_finish() -> None:
    """Let the collector of garbage pass over what lives as long as the tests: it took a sixteenth of their time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Write the tests that failed where `.ci/run` asks for them, so that it can say how to repeat each."""
    if file := os.environ.get("CI_FAILED_TESTS"):
        stats = terminalreporter.stats
        failed = {
            report.nodeid for report in [*stats.get("failed", ()), *stats.get("error", ())]
        }
        Path(file).write_text("".join(f"{name}\n" for name in sorted(failed)), "utf-8")
