"""The blocks of a raster cover its extent once, and none of them shows."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import hypothesis
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.invariants.runs import do, dtm, metres, settings, the_store
from tiler.core.lattice import Bounds, Lattice
from tiler.core.raster import Block, RasterSpec
from tiler.filter.tasks.passes import label_digests
from tiler.grid.block import block_heights
from tiler.grid.tasks.gridding import GridContext
from tiler.grid.tasks.raster_table import raster_table
from tiler.plan import make_plan
from tiler.runs.found import IngestResult

SIZES = st.fractions(min_value=Fraction(1, 3), max_value=3000, max_denominator=400)
COUNTS = st.integers(-(10**7), 10**7)


@hypothesis.settings(deadline=None)  # other work on the machine is no failure
@given(COUNTS, COUNTS, st.integers(1, 3000), st.integers(1, 3000), SIZES, st.integers(1, 600))
def test_blocks_cover_each_pixel_once(
    x: int, y: int, wide: int, high: int, size: Fraction, block: int
) -> None:
    extent = Bounds(x, y, x + wide, y + high)
    lattice = Lattice(max(size, Fraction(max(wide, high), 300)))
    spec = RasterSpec.covering(lattice, extent)
    times = np.zeros((spec.height, spec.width), int)
    for part in spec.blocks(block):
        times[part.row : part.row + part.height, part.col : part.col + part.width] += 1
    assert (times == 1).all()
    whole = spec.block_bounds(Block(0, 0, spec.height, spec.width))
    assert whole.union(extent) == whole
    inner = spec.block_bounds(Block(1, 1, max(spec.height - 2, 0), max(spec.width - 2, 0)))
    assert inner.empty or (
        inner.x0 > x and inner.y0 > y and inner.x1 < x + wide and inner.y1 < y + high
    )


def test_each_block_is_one_task_and_none_shows(
    quarter_files: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    result = do(quarter_files, out, resolution="0.3")
    assert result.summary["stages"]["grid-dtm"]["tasks"] == 4
    plan = make_plan([str(p) for p in quarter_files], settings(resolution="0.3"))
    store = the_store(out)
    assembled = IngestResult.of(store.committed("assemble"))
    labels = label_digests(assembled, store.committed("filter0"))
    gridding = GridContext(plan, assembled, labels)
    spec = gridding.spec
    tasks = list(raster_table(plan)["dtm"].tasks(gridding))
    blocks = [task.arguments["work"].block for task in tasks]
    assert blocks == list(spec.blocks(512))
    assert len({task.key for task in tasks}) == 4
    whole = replace(
        tasks[0].arguments["work"], block=Block(0, 0, spec.height, spec.width), max_points=10**9
    )
    heights, _ = block_heights(store, whole)
    pixels, transform = dtm(out)
    assert pixels.tobytes() == heights.tobytes()
    assert transform.a == float(metres(0.3))
    assert (pixels != -9999).mean() > 0.98
