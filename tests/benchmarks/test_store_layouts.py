"""The benchmark of the store's layouts runs, and measures all of them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).with_name("store_layouts.py")


@pytest.mark.slow
def test_the_benchmark_prints_its_table() -> None:
    command = [sys.executable, "-W", "error", str(BENCHMARK), "--points", "20000"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    head, *lines = done.stdout.strip().splitlines()
    assert head.startswith("20000 points, 1 buckets")
    assert len([line for line in lines if line.startswith("| columns, rows of ")]) == 9
    assert len([line for line in lines if line.startswith("| group per bucket")]) == 1
