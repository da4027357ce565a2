"""The runner of steps: blocks do not show, and the digest of a task follows what its block reads."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.tiler.grid.conftest import make_block, sources_of
from tiler.core.lattice import Lattice
from tiler.core.products import Read
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec
from tiler.grid.tasks.steps import Step, all_of
from tiler.store import TileStore

SIDE = 40
WIDE = RasterSpec(Lattice(Fraction(1000)), 0, 0, 3 * BLOCK_PIXELS, 3 * BLOCK_PIXELS)


def around(
    heights: np.ndarray, numbers: np.ndarray, *, margin: int
) -> tuple[Any, Mapping[str, int]]:
    """Return the mean of the known heights around each pixel, and the least number."""
    size = 2 * margin + 1
    windows = np.lib.stride_tricks.sliding_window_view(heights, (size, size)).reshape(
        *(side - 2 * margin for side in heights.shape), -1
    )
    known = ~np.isnan(windows)
    total, n = np.where(known, windows, 0.0).sum(axis=-1), known.sum(axis=-1)
    return np.where(n > 0, total / np.maximum(n, 1), np.nan), {"least": int(numbers.min())}


def reads_of(margin: int) -> dict[str, Read]:
    return {"heights": Read("raster:dtm", margin), "numbers": Read("numbers:counts", margin)}


def made_at(store: TileStore, data: list[np.ndarray], top: int, left: int, margin: int) -> Any:
    """Return the means, and the least number, of data in a raster with ``top`` and ``left`` pixels before them."""
    spec = RasterSpec(Lattice(Fraction(1000)), -left, top, SIDE + top, SIDE + left)
    for name, values in zip(("dtm", "counts", "means"), (*data, data[0]), strict=True):
        fill = 0.0 if name == "counts" else NODATA
        whole = np.full((spec.height, spec.width), fill, np.float32)
        whole[top:, left:] = values
        store.create_raster(name, spec, fill)
        for b in spec.blocks(BLOCK_PIXELS):
            part = whole[b.row : b.row + b.height, b.col : b.col + b.width]
            store.write_block(name, b, part)
    counts = [
        make_block(store, "means", around, reads_of(margin), spec, b, NODATA, margin=margin)
        for b in spec.blocks(BLOCK_PIXELS)
    ]
    means = store.read_block("means", Block(top, left, SIDE, SIDE))
    filled = (means != np.float32(NODATA)).sum()
    assert sum(c["filled"] for c in counts) >= filled > 0
    return means.tobytes(), min(c["least"] for c in counts)


@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    st.integers(BLOCK_PIXELS - SIDE, BLOCK_PIXELS),
    st.integers(BLOCK_PIXELS - SIDE, BLOCK_PIXELS),
    st.integers(0, 2),
    st.integers(0, 2**32 - 1),
)
def test_blocks_do_not_show(
    small_store: TileStore, top: int, left: int, margin: int, seed: int
) -> None:
    """The same pixels in one block, and cut by the sides of four."""
    random = np.random.default_rng(seed)
    heights = random.integers(0, 100, (SIDE, SIDE)).astype(np.float32)
    heights[random.random((SIDE, SIDE)) < 0.3] = NODATA
    # A number may be -9999: it is no missing value.
    data = [heights, random.choice(np.float32([NODATA, 1, 5]), (SIDE, SIDE))]
    alone = made_at(small_store, data, 0, 0, margin)
    assert made_at(small_store, data, top, left, margin) == alone
    assert alone[1] == NODATA


def digests(step: Step, changed: str = "") -> dict[str, str]:
    """Return the digests of the tasks of a step if the block ``changed`` of its raster has other pixels."""
    made = {
        b.name: ("", {"filled": 1, "checksum": "new" if b.name == changed else "old"})
        for b in WIDE.blocks(BLOCK_PIXELS)
    }
    context = SimpleNamespace(
        made={"dtm": made},
        sources=sources_of(WIDE),
        spec_of=lambda grid: WIDE,
        n_points=lambda cells: 0,
        checksums=lambda raster, names: [[name, made[name][1]["checksum"]] for name in names],
    )
    return {task.key: task.digest for task in step.tasks(context)}


def near(block: Block, other: Block, margin: int) -> bool:
    """Whether a block lies within a margin of another one."""
    return all(
        abs(a - b) < BLOCK_PIXELS + margin
        for a, b in ((block.row, other.row), (block.col, other.col))
    )


@settings(deadline=None)
@given(st.integers(0, 2 * BLOCK_PIXELS), st.integers(0, 8))
def test_only_blocks_that_read_other_pixels_are_made_again(margin: int, number: int) -> None:
    step = Step("means", around, {"heights": Read("raster:dtm", margin)}, all_of("heights"))
    blocks = list(WIDE.blocks(BLOCK_PIXELS))
    before, after = digests(step), digests(step, blocks[number].name)
    assert before.keys() == {block.name for block in blocks}
    for block in blocks:
        changed = before[block.name] != after[block.name]
        assert changed == near(block, blocks[number], margin), block.name


def test_other_values_and_another_raster_are_another_digest() -> None:
    reads = {"heights": Read("raster:dtm")}
    steps = [
        Step(name, around, reads, all_of("heights"), {"margin": margin})
        for name, margin in (("means", 0), ("means", 1), ("others", 0))
    ]
    first = [digests(step)[WIDE.block_at(0, 0, BLOCK_PIXELS).name] for step in steps]
    assert len(set(first)) == 3
