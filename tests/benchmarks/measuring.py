"""One filter on one scene: errors of its labels and of their terrain, time, memory."""

from __future__ import annotations

import ctypes
import gc
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ptd.tin import Pixels, Tin, rasterise
from tests.benchmarks.scorecard_scenes import BenchScene, Cloud
from tiler.apps.evaluate import IGNORED, evaluate_labels

GROUND, LOW_NOISE = 2, 7

FLOOR = "floor"
"""No filter: what lies nearer to the true terrain than one height, the best one for the scene.
It sees the truth."""

Filter = Callable[[Cloud], np.ndarray]
"""From a cloud to ASPRS classes, uint8 [n], or only to what is ground, bool [n]."""


def nearest_to_truth(cloud: Cloud) -> np.ndarray:
    """Points within one height of the true terrain, the height of 0.1 to 1 m with the fewest errors.

    Where the terrain is not known, the true ground: such points are no errors.
    """
    if cloud.truth is None:
        raise ValueError("the true terrain is not known")
    off = np.abs(cloud.xyz[:, 2] - cloud.truth(*cloud.xyz[:, :2].T))
    ground, known = cloud.classification == GROUND, ~np.isnan(off)
    counts = known & ~np.isin(cloud.classification, IGNORED)
    heights = np.arange(0.1, 1.0, 0.02)
    wrong = [np.sum((off[counts] < height) != ground[counts]) for height in heights]
    return np.asarray(np.where(known, off < heights[int(np.argmin(wrong))], ground))


AGREEMENT = ("type_1", "type_2", "total", "kappa", "iou", "mcc")
"""Scores of `tiler.apps.evaluate` in a `Cell`."""


@dataclass(frozen=True)
class Cell:
    """A filter on a scene.

    Attributes
    ----------
    method, scene, family, group : str
    points : int
    refusal : str or None
        Why there is no result.
    type_1, type_2, total, kappa, iou, mcc : float or None
        Fractions.
    dtm_rmse_m : float or None
        Of the linear TIN of what was labelled ground, where the true terrain is known; at pixels of `Cloud.pixel_m`.
    low_found, low_as_ground : float or None
        Shares of the reference low points that the filter classifies as low noise and as ground. None without low
        points, and `low_found` is None if the filter finds only ground.
    seconds : float or None
        CPU time of the fastest run.
    peak_bytes : int or None
        Memory above what was there before, at most; None where the system does not tell.
    """

    method: str
    scene: str
    family: str
    group: str
    points: int
    refusal: str | None = None
    type_1: float | None = None
    type_2: float | None = None
    total: float | None = None
    kappa: float | None = None
    iou: float | None = None
    mcc: float | None = None
    dtm_rmse_m: float | None = None
    low_found: float | None = None
    low_as_ground: float | None = None
    seconds: float | None = None
    peak_bytes: int | None = None


def measure(name: str, run: Filter, scene: BenchScene, cloud: Cloud, repeats: int) -> Cell:
    """Run a filter on a scene: once for the labels, then for the time, which is left out where nothing is repeated."""
    cell = {
        "method": name,
        "scene": scene.name,
        "family": scene.family,
        "group": scene.group,
        "points": len(cloud.xyz),
    }
    try:
        labels = run(cloud)
    except ValueError as refusal:
        return Cell(**cell, refusal=" ".join(str(refusal).split()))
    low = cloud.classification == LOW_NOISE
    found_low = None
    if labels.dtype == np.bool_:
        labels = np.where(labels, GROUND, 1).astype(np.uint8)
    elif low.any():
        found_low = float(np.mean(labels[low] == LOW_NOISE))
    ground = labels == GROUND
    found = evaluate_labels(labels, cloud.classification, IGNORED)
    seconds, peak = [], None
    for _ in range(repeats):
        before = forget_peak()
        start = time.process_time()
        run(cloud)
        seconds.append(time.process_time() - start)
        if before is not None:
            peak = max(peak or 0, resident("VmHWM") - before)
    # The terrain of the floor is that of the true ground: what labels without an error would
    # give.
    surface = cloud.classification == GROUND if name == FLOOR else ground
    errors = {key: found[key] for key in AGREEMENT}
    fastest = min(seconds, default=None)
    return Cell(
        **cell,
        **errors,
        dtm_rmse_m=dtm_rmse_m(cloud, surface),
        low_found=found_low,
        low_as_ground=float(np.mean(ground[low])) if low.any() else None,
        seconds=fastest,
        peak_bytes=peak,
    )


def dtm_rmse_m(cloud: Cloud, ground: np.ndarray) -> float | None:
    """RMSE of the labelled ground's surface at the centres of pixels; None without a true terrain."""
    if cloud.truth is None or ground.sum() < 3:
        return None
    side = int(cloud.side_m / cloud.pixel_m)
    counts = np.rint(cloud.xyz[ground].T * 1000).astype(np.int32)
    pixels = Pixels(round(1000 * cloud.pixel_m), 1, 0, side - 1, side, side)
    surface = rasterise(Tin.build(*counts), pixels).heights / 1000
    centres = (np.arange(side) + 0.5) * cloud.pixel_m
    x, y = np.meshgrid(centres, centres[::-1])
    difference = surface - cloud.truth(x, y)
    return float(np.sqrt(np.nanmean(difference**2)))


def forget_peak() -> int | None:
    """Give freed memory back and let the peak start anew; bytes in use, None where the system does not tell."""
    gc.collect()
    try:
        ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")
    except (OSError, AttributeError):
        return None
    return resident("VmRSS")


def resident(entry: str) -> int:
    """Bytes of memory: VmRSS now, VmHWM at most so far (Linux)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(line for line in lines if line.startswith(entry)).split()[1])
