"""What the machine has, and what a worker may use of it."""

from __future__ import annotations

from pathlib import Path

import psutil
import pytest

from tiler.plan import memory


def test_a_container_that_allows_less_than_the_machine_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "CGROUPS", tmp_path)
    monkeypatch.setattr(memory, "GROUPS", tmp_path / "groups")
    (tmp_path / "groups").write_text("4:cpu,cpuacct:/\n3:memory:/app\n0::/pod/app\n")
    assert memory.memory_bytes() == psutil.virtual_memory().total
    limits = {"pod/app/memory.max": "max", "pod/memory.max": "300000000"}
    for name, text in {**limits, "memory/app/memory.limit_in_bytes": "9" * 18}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert memory.memory_bytes() == 300_000_000


def test_cores_are_those_that_a_container_or_a_set_of_cores_leaves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "CGROUPS", tmp_path)
    monkeypatch.setattr(memory, "GROUPS", tmp_path / "groups")
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(64)), raising=False)
    (tmp_path / "groups").write_text("4:cpu,cpuacct:/app\n0::/pod/app\n")
    assert memory.cores() == 64
    for name, text, cores in (
        ("cpu/app/cpu.cfs_period_us", "100000", 64),
        ("cpu/app/cpu.cfs_quota_us", "-1", 64),
        ("pod/app/cpu.max", "max 100000", 64),
        ("pod/cpu.max", "1250000 100000", 13),
        ("cpu/app/cpu.cfs_quota_us", "250000", 3),
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
        assert memory.cores() == cores, name


def test_no_more_workers_than_memory_is_there_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "cores", lambda: 16)
    for mib, workers in {100: 1, 4096: 8, 8192: 16, 99999: 16}.items():
        monkeypatch.setattr(memory, "memory_bytes", lambda mib=mib: mib << 20)
        assert memory.default_workers() == workers


def test_workers_share_half_of_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "cores", lambda: 4)
    shares = {(16, 4): 2048, (16, 1): 2048, (16, 8): 1024, (2, 4): 512, (999, 2): 4096}
    for (machine_gib, workers), share_mib in shares.items():
        monkeypatch.setattr(memory, "memory_bytes", lambda gib=machine_gib: gib << 30)
        assert memory.fair_share(workers) == share_mib << 20
