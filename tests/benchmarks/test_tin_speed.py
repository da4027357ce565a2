"""Speed of the TIN against Qhull and startinpy; small as a test, full size as a script, no limits asserted.

``python tests/benchmarks/test_tin_speed.py [points]`` prints medians of five interleaved runs on one core.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
import pytest

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from ptd.tin import Pixels, Tin, rasterise
from ptd.tin.bulk import curve_order

KINDS = ("random", "grid", "clusters", "scan lines")
Columns = tuple[np.ndarray, np.ndarray, np.ndarray]


def scene(kind: str, n: int, seed: int = 0) -> Columns:
    """n points at about one a square metre, counts of a millimetre, shuffled."""
    rng = np.random.default_rng(seed)
    side = int(np.sqrt(n))
    k = rng.permutation(n)
    if kind == "random":
        x, y = rng.integers(0, 1000 * side, (2, n))
    elif kind == "grid":
        x, y = 1000 * (k % side), 1000 * (k // side)
    elif kind == "clusters":
        centres = rng.integers(100_000, 60_000_000, (2, 500))
        x, y = (centres[:, k % 500] + rng.normal(0, 20_000, (2, n))).astype(np.int64)
    else:
        x, y = 300 * (k % side) + rng.integers(-5, 6, n), 3000 * (k // side) + k % side // 3
    return x.astype(np.int32), y.astype(np.int32), rng.integers(0, 10_000, n).astype(np.int32)


def qhull(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> None:
    from scipy.spatial import Delaunay

    Delaunay(np.column_stack((x, y)).astype(float))


def startinpy(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> None:
    import startinpy as rival

    order = curve_order(x, y)  # it does not sort by itself
    tin = rival.DT()
    tin.insert(np.column_stack((x, y, z)).astype(float)[order] / 1000, insertionstrategy="AsIs")


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def compare(kind: str, n: int, rounds: int) -> dict[str, float]:
    """Median seconds by contestant."""
    points = scene(kind, n)
    contestants: dict[str, Callable[..., object]] = {
        "ptd.tin": Tin.build,
        "qhull": qhull,
        "startinpy": startinpy,
    }
    times: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, build in contestants.items():
            times[name].append(seconds(lambda build=build: build(*points)))
    return {name: median(values) for name, values in times.items()}


@pytest.mark.parametrize("kind", KINDS)
def test_all_contestants_run(kind: str) -> None:
    pytest.importorskip("startinpy")
    times = compare(kind, 2500, 1)
    assert set(times) == {"ptd.tin", "qhull", "startinpy"}
    tin = Tin.build(*scene(kind, 2500))
    assert tin.n_triangles == 2 * tin.n_vertices - 2


def main(n: int) -> None:
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    compare("random", 1000, 1)  # compiles
    for kind in KINDS:
        times = compare(kind, n, 5)
        own = times["ptd.tin"]
        ratios = ", ".join(
            f"{name} takes {t / own:.1f} x" for name, t in times.items() if name != "ptd.tin"
        )
        print(f"{kind:10} {n / own / 1e6:5.2f} M points/s; {ratios}", flush=True)
    tin = Tin.build(*scene("random", n))
    used = 16 * tin.n_vertices + 32 * tin.n_triangles
    print(f"{used / tin.n_vertices:.1f} bytes a vertex")
    side = int(np.sqrt(n))
    for interpolator in ("linear", "natural"):
        for cell in (1000, 500):
            columns = 1000 * side // cell
            pixels = Pixels(cell, 1, 0, columns - 1, columns, columns)
            limits = {"max_edge": 20_000, "max_radius": 20_000, "interpolator": interpolator}
            rasterise(tin, pixels, **limits)
            spent = median(
                seconds(lambda p=pixels, o=limits: rasterise(tin, p, **o)) for _ in range(5)
            )
            print(
                f"{interpolator:8} {cell} mm: {columns**2 / spent / 1e6:5.2f} M cells/s",
                flush=True,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
