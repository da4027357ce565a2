"""Seeds and candidates by chance, and densification the slow way: Qhull, one test after another."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import Delaunay

from ptd.frame import Window
from ptd.ground.criteria import FacetLimits

EVERYTHING = Window.everything()


CORNERS = np.array(
    [[-50_000, -50_003, 0], [150_001, -50_000, 0], [-50_002, 150_000, 0], [150_000, 150_004, 0]]
)


def measures(corners: np.ndarray, p: np.ndarray) -> tuple[float, float, float, float]:
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal = normal / np.linalg.norm(normal) * np.sign(normal[2])
    edges = corners[[1, 2, 0], :2] - corners[:, :2]
    nearest = np.linalg.norm(corners - p, axis=1).min()
    return abs(normal @ (p - corners[0])), nearest, normal[2] ** 2, np.hypot(*edges.T).max()


def passes(points: np.ndarray, mesh: Delaunay, p: np.ndarray, limits: FacetLimits) -> bool:
    """One test, without any care for speed."""
    corners = points[mesh.simplices[int(mesh.find_simplex(p[:2]))]]
    distance, nearest, cos2, edge = measures(corners, p)
    if edge < limits.stop_edge:
        return False
    if cos2 < limits.steep_cos2:
        top = corners[corners[:, 2].argmax()]
        p = np.array([*(2 * top[:2] - p[:2]), p[2]])
        other = int(mesh.find_simplex(p[:2]))
        if other < 0:
            return False
        distance, nearest, _, edge = measures(points[mesh.simplices[other]], p)
    angle = limits.angle * min(1.0, edge / limits.reduce_edge if limits.reduce_edge else 1.0)
    return bool(distance <= limits.distance and distance <= nearest * math.sin(angle))


def naive(
    seeds: np.ndarray, candidates: np.ndarray, limits: FacetLimits, rounds: int
) -> np.ndarray:
    """Which candidates become vertices."""
    chosen = np.zeros(len(candidates), bool)
    done = 0
    while rounds == 0 or done < rounds:
        done += 1
        points = np.vstack([seeds, candidates[chosen]]).astype(float)
        mesh = Delaunay(points[:, :2])
        new = [
            k
            for k in np.flatnonzero(~chosen)
            if passes(points, mesh, candidates[k].astype(float), limits)
        ]
        if not new:
            break
        chosen[new] = True
    return chosen


def scene(seed: int, n: int, rough: int) -> tuple[np.ndarray, np.ndarray]:
    """Four corners, then candidates on rough hills."""
    rng = np.random.default_rng(seed)
    xy = rng.integers(0, 100_000, (n, 2))
    z = (
        6000 * np.sin(xy[:, 0] / 17_000)
        + 3000 * (xy[:, 1] > 40_000)
        + rng.integers(0, rough, n)
    )
    points = np.column_stack([xy, z.astype(np.int64)])
    return np.vstack([CORNERS, points[:5]]), points[5:]
