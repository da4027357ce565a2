"""Several processes write different buckets of one store at the same time, and nothing is lost."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.waiting import PATIENCE_SECONDS
from tiler.core.lattice import Cell
from tiler.store import BucketInfo, TileStore

pytestmark = pytest.mark.processes

REPOSITORY = Path(__file__).resolve().parents[3]
WORKER = """
import sys
import numpy as np
import pytest
from tiler.core.lattice import Cell
from tiler.core.points import PointBlock
from tiler.store import open_store
url, first, last = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
for ix in range(first, last):
    store = open_store(url)  # as each task does
    n = 10 + ix
    x = np.full(n, store.meta.bucket.first(ix) - store.meta.frame.origin[0])
    y = np.full(n, -store.meta.frame.origin[1])
    xyz = np.stack([x, y, np.arange(n)]).astype(np.int32)
    attribute = np.full(n, ix, np.uint8)
    block = PointBlock(xyz, attribute, attribute, np.stack([attribute] * 2),
                       np.full((3, n), ix, np.uint16), np.arange(n) + ix)
    info = store.write_bucket(Cell(ix, 0), block, 1)
    store.commit("assemble", f"{ix}", "d", {"n": info.n})
"""


def test_two_processes_write_different_buckets(local_store: TileStore) -> None:
    local_store.allocate({Cell(ix, 0): 10 + ix for ix in range(40)})
    workers = [
        subprocess.Popen(
            [sys.executable, "-W", "error", "-c", WORKER, local_store.url, str(a), str(b)],
            cwd=REPOSITORY,
        )
        for a, b in [(0, 20), (20, 40)]
    ]
    assert [w.wait(timeout=PATIENCE_SECONDS) for w in workers] == [0, 0]

    done = local_store.committed("assemble")
    assert len(done) == 40
    local_store.publish_index(
        {Cell(int(k), 0): BucketInfo(r["n"], 1) for k, (_, r) in done.items()}
    )
    for ix in range(40):
        block = local_store.read_bucket(Cell(ix, 0), ("xyz", "classification", "rgb", "origin"))
        assert np.array_equal(block.xyz[2], np.arange(10 + ix))
        assert np.array_equal(block.origin, np.arange(10 + ix) + ix)
        assert set(block.classification.tolist()) == {ix}  # type: ignore[union-attr]


LABELS = """
import sys
import numpy as np
import pytest
from tiler.store import open_store
url, odd = sys.argv[1], int(sys.argv[2])
for i, (cell, info) in enumerate(open_store(url).buckets().items()):
    if i % 2 == odd:
        open_store(url).write_labels("pass", cell, np.full(info.n, i, np.uint8))
"""


def test_two_processes_start_the_same_labels(filled: TileStore) -> None:
    workers = [
        subprocess.Popen(
            [sys.executable, "-W", "error", "-c", LABELS, filled.url, str(i)], cwd=REPOSITORY
        )
        for i in (0, 1)
    ]
    assert [w.wait(timeout=PATIENCE_SECONDS) for w in workers] == [0, 0]
    for i, (cell, info) in enumerate(filled.buckets().items()):
        assert filled.read_labels("pass", cell).tolist() == [i] * info.n
