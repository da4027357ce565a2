"""What a worker tells of a task."""

from __future__ import annotations

import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tiler.core.frame import CoordFrame
from tiler.core.lattice import Lattice
from tiler.runs.worker import peak_rss_bytes, perform
from tiler.schedule import Task
from tiler.store import StoreMeta, create_store


def takes(_: str, args: dict[str, Any]) -> dict[str, Any]:
    """Fill some megabytes in pieces, of which every other one is freed before the rest."""
    pieces = [np.ones(1 << 14) for _ in range(args["megabytes"] * 8)]
    del pieces[::2]
    return {"pieces": len(pieces)}


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="peaks begin anew on Linux alone")
def test_a_task_is_told_of_with_its_own_peak(tmp_path: Path) -> None:
    url = str(tmp_path / "store.zarr")
    create_store(url, StoreMeta(CoordFrame(), Lattice(Fraction(50_000)), Lattice(Fraction(500)), False))
    large, small = (
        perform(url, Task("s", f"{size}", "d", takes, {"megabytes": size}, 1)) for size in (256, 1)
    )
    assert large.record == {"pieces": 1024}
    assert large.peak_rss_bytes - small.peak_rss_bytes > 200 << 20
    assert peak_rss_bytes() < large.peak_rss_bytes
