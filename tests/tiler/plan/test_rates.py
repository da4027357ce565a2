"""What is remembered of earlier runs: rates of whole stages, of runs large enough."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.tiler.plans import changed
from tiler.config import RunConfig
from tiler.core.results import StageResult
from tiler.plan import Plan, make_plan, remember
from tiler.plan.estimates import projected_seconds


@pytest.fixture
def plan(make_cloud: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Plan:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    small = make_plan(
        [str(make_cloud("a.las", n=50))],
        RunConfig(method="classic", in_process=True, workers=2),
    )
    return changed(small, points=4_000_000)


def stages(seconds: float, computed: int = 8) -> dict[str, StageResult]:
    names = ("spool", "assemble", "filter0", "grid-dtm", "export")
    usual = StageResult(
        stage="", title="", tasks=8, done=0, points=0, pixels=0, computed=computed, seconds=seconds,
        peak_rss_bytes=0,
    )  # fmt: skip
    return {name: replace(usual, stage=name) for name in names}


def test_time_follows_from_the_rates_of_earlier_runs(plan: Plan) -> None:
    guess, known = projected_seconds(plan)
    assert not known
    assert guess > 0
    remember(plan, stages(10.0))
    assert projected_seconds(plan) == (pytest.approx(50.0), True)
    assert projected_seconds(changed(plan, points=8_000_000, workers=4)) == (
        pytest.approx(50.0),
        True,
    )
    remember(plan, stages(20.0))
    assert projected_seconds(plan) == (pytest.approx(75.0), True), "half of it is the newest"
    other = changed(replace(plan, config=plan.config.updated(method="keep")), passes=())
    assert projected_seconds(other) == (pytest.approx(60.0), True)
    assert not projected_seconds(replace(plan, config=plan.config.updated(method="rarefy")))[1]


def test_parts_of_stages_and_small_runs_are_no_rates(plan: Plan) -> None:
    before = projected_seconds(plan)
    remember(plan, stages(10.0, computed=7))
    remember(plan, stages(0.0, computed=0))
    remember(changed(plan, points=999_999), stages(10.0))
    assert projected_seconds(plan) == before


@pytest.mark.parametrize(
    "content", ["", "[]", '{"version": "0"}', '{"version": "0.1.0", "seconds_per_million": 3}']
)
def test_a_damaged_memory_is_none(content: str, plan: Plan, tmp_path: Path) -> None:
    before = projected_seconds(plan)
    (tmp_path / "cache" / "tiler-dtm").mkdir(parents=True)
    (tmp_path / "cache" / "tiler-dtm" / "rates.json").write_text(content)
    assert projected_seconds(plan) == before
    remember(plan, stages(10.0))
    assert projected_seconds(plan)[1]


def test_a_cache_that_cannot_be_written_hurts_nobody(plan: Plan, tmp_path: Path) -> None:
    before = projected_seconds(plan)
    (tmp_path / "cache").write_text("in the way")
    remember(plan, stages(10.0))
    assert projected_seconds(plan) == before
