"""Morphological seeds, few rounds of densification, a roof veto and a pass over heights: what an earlier prototype did.

    python tests/benchmarks/lessons_chain.py [folder of clouds]

prints its errors on the ISPRS samples (Sithole and Vosselman 2004) and its speed on one core, for comparison with the
methods of `ptd.methods`: a composition of the same parts, with one setting for all clouds.
"""

from __future__ import annotations

import math
import os
import sys
import time
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from statistics import mean, median

import laspy
import numpy as np

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from ptd.cells import Int32, lowest_per_cell
from ptd.frame import Cells, Scale, Window
from ptd.ground.certificates import Doubt
from ptd.ground.criteria import Limits
from ptd.ground.densify import REFUSED, VERTEX, WAITING, densify
from ptd.ground.labelling import GROUND, UNCLASSIFIED
from ptd.ground.morphology import Bool, CellRaster, steepest_drops
from ptd.ground.outliers import low_outliers
from ptd.ground.seeds import box_with_ring, choose_seeds
from ptd.ground.slopes import slopes
from ptd.kernel import kernel, wide
from ptd.tin.interpolation import facet_plane, height_on
from ptd.tin.layout import Int32Array, is_ghost
from ptd.tin.location import coincident_vertex, locate
from ptd.tin.locator import Locator, start_near
from ptd.tin.mesh import Tin
from tiler.apps.evaluate import evaluate_labels

CELL_M = 1.0
RADII = tuple(float(r) for r in range(1, 19))
RING_M = 20.0
SLOPE_REACH = 7
FLOOR_M, PER_SLOPE_M = 0.3, 1.0
LOW = {"radius_m": 5.0, "depth_m": 4.0, "group": 5}
DENSIFY = {"distance_m": 1.4, "angle_deg": 28.0, "terrain_deg": 88.0, "reduce_m": 5.0}
ROUNDS = 4
FOOT = Fraction(3048, 10000)
"""Metres."""


@dataclass(frozen=True)
class Threshold:
    """An object drops by more than ``drop_m + (per_metre + per_slope * slope) * radius``."""

    drop_m: float
    per_metre: float
    per_slope: float


SEEDS = Threshold(0.1, 0.06, 0.2)
VETO = Threshold(0.5, 0.1, 0.3)
"""Wider than for seeds: a veto by the seeds' threshold would take back all that densification adds."""


def objects(raster: CellRaster, z: Int32, which: Bool, scale: Scale, limit: Threshold) -> Bool:
    """Which of all points lie in cells where the chosen points' minimum raster drops like an object."""
    unit = scale.counts_z(CELL_M)  # counts per cell of a slope of 1
    steepest, opened = steepest_drops(raster.lowest(z, which), RADII, scale.counts_z(limit.drop_m))
    allowed = limit.per_metre * unit + limit.per_slope * slopes(opened, SLOPE_REACH)
    return (steepest > allowed).reshape(-1)[raster.keys]


def triangulate(x: Int32, y: Int32, z: Int32, chosen: Bool, ring: Int32) -> Tin:
    """TIN of the chosen points and the ring, with room for all."""
    columns = (np.concatenate([c[chosen], r]) for c, r in zip((x, y, z), ring.T, strict=True))
    return Tin.build(*columns, max_vertices=x.size + len(ring))


@kernel
def _label(
    vertices: Int32Array,
    triangles: Int32Array,
    x: Int32,
    y: Int32,
    z: Int32,
    locator: Locator,
    floor: float,
    per_slope: float,
    labels: np.ndarray,
) -> None:
    for i in range(x.size):
        px, py = wide(x[i]), wide(y[i])
        t = locate(vertices, triangles, px, py, start_near(locator, px, py))
        if is_ghost(triangles, t):
            continue
        v = coincident_vertex(vertices, triangles, px, py, t)
        if v >= 0:
            off, allowed = float(z[i] - vertices[4 * v + 2]), floor
        else:
            plane = facet_plane(vertices, triangles, t)
            off = float(z[i]) - height_on(plane, px, py, 1)
            slope = math.sqrt(plane.slope_x * plane.slope_x + plane.slope_y * plane.slope_y) / plane.area
            allowed = floor + per_slope * slope
        if abs(off) <= allowed:
            labels[i] = GROUND


def label_by_height(tin: Tin, xyz: Int32, scale: Scale) -> np.ndarray:
    """Ground is what lies within ``FLOOR_M + PER_SLOPE_M * slope`` above or below the TIN."""
    labels = np.full(xyz.shape[1], UNCLASSIFIED, np.uint8)
    _label(
        tin.vertex_array,
        tin.triangle_array,
        *xyz,
        Locator.of(tin),
        scale.counts_z(FLOOR_M),
        scale.counts(PER_SLOPE_M),
        labels,
    )
    return labels


def classify(xyz: Int32, scale: Scale) -> np.ndarray:
    """ASPRS classes, uint8 [n], of points in local counts, int32 [3, n], that are all there is."""
    cells = Cells.of(CELL_M, scale)
    x, y, z = xyz[:, lowest_per_cell(*xyz, cells)]
    outlier = low_outliers(x, y, z, scale, **LOW)
    raster = CellRaster(x, y, cells)
    seed = ~outlier & ~objects(raster, z, ~outlier, scale, SEEDS)

    ring_cells, everything = Cells.of(RING_M, scale), Window.everything()
    doubt = Doubt(everything, everything, box_with_ring(x, y, ring_cells), scale)
    ring = choose_seeds(x, y, z, seed, ring_cells, doubt).virtual
    tin = triangulate(x, y, z, seed, ring)
    state = np.where(outlier, REFUSED, np.where(seed, VERTEX, WAITING)).astype(np.uint8)
    densify(tin, x, y, z, state, Limits.of(scale, **DENSIFY), ROUNDS, doubt)

    ground = state == VERTEX
    vetoed = ground & ~seed & objects(raster, z, ground, scale, VETO)
    if vetoed.any():
        tin = triangulate(x, y, z, ground & ~vetoed, ring)
    return label_by_height(tin, xyz, scale)


def load(path: Path, unit: Fraction = Fraction(1)) -> tuple[Int32, Scale, np.ndarray]:
    """Thousandths of the file's unit (in metres), what they mean, and the classes."""
    cloud = laspy.read(path)
    counts = [np.rint(np.asarray(c) * 1000).astype(np.int64) for c in (cloud.x, cloud.y, cloud.z)]
    origin = int(counts[0].min()), int(counts[1].min())
    xyz = np.stack([counts[0] - origin[0], counts[1] - origin[1], counts[2]]).astype(np.int32)
    return xyz, Scale(unit / 1000, unit / 1000, origin), np.asarray(cloud.classification)


def errors(folder: Path) -> dict[str, dict[str, float]]:
    """Type I, type II, total error and kappa of each ISPRS sample."""
    table = {}
    for path in sorted(folder.glob("samp*.laz")):
        xyz, scale, truth = load(path)
        found = evaluate_labels(classify(xyz, scale), truth)
        table[path.stem[4:6]] = {name: found[name] for name in ("type_1", "type_2", "total", "kappa")}
    return table


def main(data: Path) -> None:
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    print("sample  type I  type II   total   kappa   (%)")
    table = errors(data / "isprs")
    table["mean"] = {name: mean(row[name] for row in table.values()) for name in table["11"]}
    for sample, row in table.items():
        print(f"{sample:>6}", *(f"{100 * value:7.2f}" for value in row.values()), flush=True)
    xyz, scale, _ = load(data / "autzen" / "autzen_en.laz", FOOT)
    spent = []
    for _ in range(5):  # the samples have compiled everything
        start = time.process_time()
        classify(xyz, scale)
        spent.append(time.process_time() - start)
    n = xyz.shape[1]
    print(f"{n} points: {median(spent):.2f} CPU s, {n / median(spent) / 1e6:.2f} M points/s on one core")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[3] / "shared" / "data")
