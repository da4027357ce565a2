"""Tiles whose windows hold too many points are divided, nothing else changes; the memory that divides them is kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.invariants import clouds
from tests.invariants.runs import computed, do, stored_labels, the_store
from tiler.errors import ConfigError

HALO_M = 16
FINE = {"thin_cell": "0.5"}
"""Cells so small that a place flown seven times holds more candidates."""


@pytest.fixture
def crowded(tmp_path: Path) -> list[Path]:
    """A city whose south-west corner, a seventh of its area, was flown seven times."""
    whole = clouds.city(160.0)
    corner = np.flatnonzero((whole.xyz[:, :2] < 60.0).all(axis=1))
    paths = [clouds.write(tmp_path / "whole.laz", whole)]
    for number in range(6):
        strip = clouds.Cloud(
            np.round(whole.xyz[corner] + np.array([0.37, 0.23, 0.0]) * (number + 1), 3),
            whole.truth[corner],
        )
        paths.append(clouds.write(tmp_path / f"again{number}.laz", strip))
    return paths


def test_a_tile_that_is_too_full_is_divided(
    crowded: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    monkeypatch.setattr("tiler.plan.sizes.BUCKETS_M", (32,))
    do(
        crowded,
        tmp_path / "whole",
        until="filter",
        tile_size="256",
        halo=HALO_M,
        parameters=FINE,
    )
    expected, doubtful = stored_labels(tmp_path / "whole")
    # So dear that the fullest windows of 64 m do not fit, those of a bucket of 32 m and its
    # halo do.
    monkeypatch.setattr("tiler.plan.memory.READ_BYTES", 40_000)
    settings = {"tile_size": "64", "halo": HALO_M, "memory": "1GiB", "parameters": FINE}
    done = computed(do(crowded, out, until="filter", **settings))
    names = sorted(the_store(out).committed("filter0"))
    parts = [name for name in names if "." in name]
    assert parts, "nothing was divided"
    assert len(parts) < len(names), "everything was divided"
    assert done["filter0"] == len(names)
    found, marked = stored_labels(out)
    sure = ~(marked | doubtful)
    assert sure.mean() > 0.4
    assert np.array_equal(found[sure], expected[sure])

    again = computed(
        do(crowded, out, until="filter", **{**settings, "memory": "3GiB", "tile_size": None})
    )
    assert not any(again.values()), "more memory, the same tiles"
    with pytest.raises(ConfigError, match=r"filter needs .* use --memory \d+MiB or --"):
        do(crowded, out, until="filter", **{**settings, "memory": "800MiB"})
