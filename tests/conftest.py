"""Fixtures that all tests share."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

# The same examples on every run, however slow the machine: what fails in CI fails at home.
settings.register_profile(
    "tests", deadline=None, derandomize=True, database=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("tests")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real clouds beside the repository; skips where it is absent."""
    if not SHARED_DATA.is_dir():
        pytest.skip("no real clouds: ../shared/data is absent")
    return SHARED_DATA
