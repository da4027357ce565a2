"""Speed and memory of `classic`; small as a test, on a real cloud as a script, no limits asserted.

``python tests/benchmarks/test_classic_speed.py [file.laz]`` prints medians of five runs on one core, JIT warm, beside
the time that laspy with lazrs takes to decode the same file on that core.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from statistics import median

import numpy as np

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from ptd.frame import Scale, Window
from ptd.methods.classic import Classic, ClassicModel
from ptd.passes import Points

AUTZEN = Path(__file__).resolve().parents[3] / "shared" / "data" / "autzen" / "autzen_en.laz"
FOOT = Fraction(3048, 10_000)
RUNS = 5


def hills(n: int) -> np.ndarray:
    """n points at two a square metre with houses and trees, counts of a millimetre: int32 [3, n]."""
    rng = np.random.default_rng(0)
    x, y = rng.random((2, n)) * np.sqrt(n / 2)
    z = 5 * np.sin(x / 40) + 3 * np.cos(y / 30) + rng.normal(0, 0.05, n)
    z[(x % 60 < 14) & (y % 50 < 11)] += 7
    trees = rng.random(n) < 0.2
    z[trees] += rng.random(trees.sum()) * 15
    return np.rint(np.stack([x, y, z]) * 1000).astype(np.int32)


def read(path: Path) -> np.ndarray:
    """Decode a file, and nothing more: int32 [3, n] in its own counts."""
    import laspy

    with laspy.open(path, laz_backend=laspy.LazBackend.Lazrs) as reader:
        las = reader.read()
    return np.stack([las.X, las.Y, las.Z])


def in_frame(path: Path, xyz: np.ndarray) -> tuple[np.ndarray, Scale]:
    """Counts relative to the south-west corner, and their scale (Autzen's counts are feet)."""
    import laspy

    with laspy.open(path) as reader:
        header = reader.header
    crs = header.parse_crs()
    unit = FOOT if crs is not None and "foot" in crs.axis_info[0].unit_name else Fraction(1)
    sizes = [Fraction(str(float(s))) * unit for s in header.scales]
    step = [Fraction(str(float(s))) for s in header.scales]
    origin = [
        round(Fraction(str(float(o))) / s) + int(v)
        for o, s, v in zip(header.offsets, step, xyz.min(axis=1), strict=True)
    ]
    local = (xyz - np.array([xyz[0].min(), xyz[1].min(), 0])[:, None]).astype(np.int32)
    return local, Scale(sizes[0], sizes[2], (origin[0], origin[1]))


def fit_and_label(xyz: np.ndarray, scale: Scale, window: Window) -> tuple[ClassicModel, np.ndarray]:
    """The whole of the filter's work on a tile."""
    model = fitted(xyz, scale, window)
    return model, model.label(Points(xyz))[0]


def fitted(xyz: np.ndarray, scale: Scale, window: Window) -> ClassicModel:
    return Classic().passes[0].fit(Points(xyz), window, window, scale, {})


def seconds(work: Callable[[], object]) -> float:
    """Wall time."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def resident(entry: str) -> int:
    """Bytes of memory: VmRSS now, VmHWM at most so far (Linux)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(line for line in lines if line.startswith(entry)).split()[1])


def test_a_small_cloud_is_done_in_one_go() -> None:
    xyz = hills(4000)
    model, labels = fit_and_label(xyz, Scale(), Window.everything())
    assert labels.size == 4000
    assert model.stats["vertices"] > 500


def main(path: Path) -> None:
    """Print the figures."""
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    os.environ["RAYON_NUM_THREADS"] = "1"
    for window in (Window.everything(), Window(0, 0, 40_000, 40_000)):
        fit_and_label(hills(4000), Scale(), window)  # compiles
    xyz, scale = in_frame(path, read(path))
    n = xyz.shape[1]
    before = resident("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew
    model, labels = fit_and_label(xyz, scale, Window.everything())
    print(f"{path.name}: {n} points, {(labels == 2).mean():.1%} ground, {model.stats}")
    print(f"memory: {(resident('VmHWM') - before) / n:.0f} bytes a point above the input")
    side = Window(0, 0, int(xyz[0].max()) + 1, int(xyz[1].max()) + 1)
    times: dict[str, list[float]] = {"fit and label": [], "with doubt": [], "fit": [], "decode": []}
    for _ in range(RUNS):
        times["fit and label"].append(seconds(lambda: fit_and_label(xyz, scale, Window.everything())))
        times["with doubt"].append(seconds(lambda: fit_and_label(xyz, scale, side)))
        times["fit"].append(seconds(lambda: fitted(xyz, scale, Window.everything())))
        times["decode"].append(seconds(lambda: read(path)))
    decode = median(times["decode"])
    for name, values in times.items():
        spent = median(values)
        print(f"{name:14} {spent:6.3f} s, {n / spent / 1e6:5.2f} M points/s, {spent / decode:5.2f} x decode")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else AUTZEN)
