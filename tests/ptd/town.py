"""A small coloured town as in image matching: roofs, facades, crowns without ground below, lawns and cars."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from ptd.frame import Scale
from ptd.passes import Points

CM = 100
SCALE = Scale(Fraction(1, CM), Fraction(1, CM), (3_500_050, 58_000_020))
SIGMA_M = 0.06
GREY, RED, GREEN = (120, 118, 116), (150, 95, 80), (90, 140, 60)
HOUSE, CAR, TREE = 6, 1, 5


@dataclass(frozen=True)
class Town:
    """Points and their truth: 2 ground, 3 lawn (green ground), 1 car, 5 tree, 6 house."""

    points: Points
    truth: np.ndarray


def ground(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 0.04 * x + 0.8 * np.sin(x / 35) + 0.6 * np.cos(y / 28)


def town(
    seed: int = 1, side: float = 120.0, density: float = 12.0, podium: bool = False
) -> Town:
    """Blocks of 30 m, each with a house of 8 m, a tree, a lawn and a car; one house stands on a podium of 3 m."""
    rng = np.random.default_rng(seed)
    n = int(density * side**2)
    x, y = rng.random((2, n)) * side
    z, truth = ground(x, y), np.full(n, 2)
    walls = []
    for row in range(int(side // 30)):
        for column in range(int(side // 30)):
            cx, cy = 30 * column + 15 + rng.uniform(-1, 1), 30 * row + 15 + rng.uniform(-1, 1)
            base = float(ground(np.array(cx), np.array(cy)))
            boxes = [
                (cx, cy, 7.0, 5.0, base + 8, HOUSE),
                (cx - 11, cy, 2.2, 0.9, base + 1.5, CAR),
            ]
            if podium and row == column == 1:
                boxes.insert(0, (cx, cy, 11.5, 9.5, base + 3, HOUSE))
            lawn = (abs(x - cx) < 6) & (abs(y - cy - 9) < 3)
            truth[lawn] = 3
            crown = (x - cx - 10) ** 2 + (y - cy + 10) ** 2 < 9
            z[crown], truth[crown] = base + rng.uniform(4, 7, crown.sum()), TREE
            for bx, by, half_x, half_y, top, what in boxes:
                inside = (abs(x - bx) < half_x) & (abs(y - by) < half_y)
                z[inside], truth[inside] = top, what
                if what == HOUSE:
                    walls.append(_walls(rng, bx, by, half_x, half_y, top, density / 2))
    wx, wy, wz = np.concatenate(walls, axis=1)
    xyz = np.array([np.append(x, wx), np.append(y, wy), np.append(z, wz)])
    truth = np.append(truth, np.full(wx.size, HOUSE))
    xyz[2] += rng.normal(0, SIGMA_M, truth.size)
    colours = np.array([GREY] * 7)
    colours[[HOUSE, TREE, 3]] = RED, GREEN, GREEN
    rgb = (
        np.clip(colours[truth] + rng.normal(0, 6, (truth.size, 3)), 0, 255).astype(np.uint16).T
    )
    order = rng.permutation(truth.size)
    counts = np.rint(xyz[:, order] * CM).astype(np.int32)
    return Town(Points(counts, rgb=np.ascontiguousarray(rgb[:, order])), truth[order])


def _walls(
    rng: np.random.Generator,
    x: float,
    y: float,
    half_x: float,
    half_y: float,
    top: float,
    density: float,
) -> np.ndarray:
    """Points on the four walls of a box, from the ground to its top: [3, n]."""
    parts = []
    for along, across, turned in ((half_x, half_y, False), (half_y, half_x, True)):
        for side in (-1, 1):
            m = int(2 * along * 10 * density)
            u, v = rng.uniform(-along, along, m), np.full(m, side * across)
            px, py = (x + v, y + u) if turned else (x + u, y + v)
            low = ground(px, py)
            part = np.array([px, py, top - rng.uniform(0, 10, m)])
            parts.append(part[:, part[2] > low])
    return np.concatenate(parts, axis=1)
