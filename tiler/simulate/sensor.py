"""An airborne laser scanner: slanted pulses along scan lines, several returns, range noise and blunders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tiler.core.classes import GROUND, HIGH_NOISE, LOW_NOISE
from tiler.simulate.objects import Floats, Objects, Rays
from tiler.simulate.terrain import Terrain

UInt8s = npt.NDArray[np.uint8]
Box = tuple[float, float, float, float]

STOP_IN_CROWN = 0.3
"""Chance that a return in a crown uses up the pulse."""


FORWARD_TILT = 0.02
"""Metres to the north per metre of height: so walls that face along the strip get points, too."""

REACH_M = 80.0
"""Surfaces lie within this height of `Terrain.base`; it bounds how far pulses lean into a box."""


@dataclass(frozen=True)
class AlsSensor:
    """Metres, degrees and counts per square kilometre in the names.

    Attributes
    ----------
    density : float
        Pulses per square metre; square pattern, scan lines along x.
    sigma_m : float
        Standard deviation of the heights.
    flying_height_m, strip_m, overlap_m : float
        Height above `Terrain.base`; distance of the strips, which run along y, and how far neighbours overlap.
    max_returns : int
        Later returns of a pulse are lost.
    low_singles_km2, low_groups_km2, high_km2 : float
        Blunders: single points 2-15 m under ground, groups of 3 to 7 points 2-6 m under ground, single
        points 20-200 m above.
    """

    density: float = 4.0
    sigma_m: float = 0.03
    flying_height_m: float = 900.0
    strip_m: float = 300.0
    overlap_m: float = 20.0
    max_returns: int = 5
    low_singles_km2: float = 150.0
    low_groups_km2: float = 40.0
    high_km2: float = 150.0


@dataclass(frozen=True)
class Returns:
    """Columns of ``n`` points: ``xyz`` float64 (n, 3), metres; the others shape (n,)."""

    xyz: Floats
    label: UInt8s
    number: UInt8s
    count: UInt8s
    angle_deg: Floats


@dataclass
class _Hits:
    """Returns as they are found, in any order: ray, height, label, and whether the pulse ends there."""

    ray: list[npt.NDArray[np.intp]]
    z: list[Floats]
    label: list[UInt8s]
    last: list[npt.NDArray[np.bool_]]

    def add(self, ray: npt.NDArray[np.intp], z: Floats, label: int, last: npt.NDArray[np.bool_]) -> None:
        self.ray.append(ray)
        self.z.append(z)
        self.label.append(np.full(len(ray), label, np.uint8))
        self.last.append(last)


def _pulses(sensor: AlsSensor, base: float, box: Box, rng: np.random.Generator) -> Rays:
    """Rays through a jittered square pattern over ``box`` (x0, y0, x1, y1) on the level ``base``, strip by strip."""
    step, lap = sensor.density**-0.5, sensor.overlap_m / 2
    rows = (np.arange(np.floor(box[1] / step), np.ceil(box[3] / step)) + 0.5) * step
    first, last = np.floor((box[0] - lap) / sensor.strip_m), np.floor((box[2] + lap) / sensor.strip_m)
    parts = []
    for strip in np.arange(first, last + 1):
        west = max(box[0], strip * sensor.strip_m - lap)
        east = min(box[2], (strip + 1) * sensor.strip_m + lap)
        columns = (np.arange(np.ceil(west / step - 0.5), np.ceil(east / step - 0.5)) + 0.5) * step
        x, y = (grid.ravel() for grid in np.meshgrid(columns, rows))
        x = x + rng.uniform(-0.2 * step, 0.2 * step, len(x))
        y = y + rng.uniform(-0.2 * step, 0.2 * step, len(y))
        lx = ((strip + 0.5) * sensor.strip_m - x) / sensor.flying_height_m
        parts.append(np.stack((x - lx * base, y - FORWARD_TILT * base, lx, np.full(len(x), FORWARD_TILT))))
    return Rays(*np.concatenate(parts, axis=1))


def _ground(terrain: Terrain, rays: Rays) -> Floats:
    """Height where each ray meets the terrain; a fixed point, as rays are much steeper than slopes."""
    z = np.full(len(rays), terrain.base)
    for _ in range(60):
        before = z
        z = terrain.height_at(*rays.at(z))
        if float(np.abs(z - before).max(initial=0.0)) < 1e-5:
            break
    return z


def _canopy(objects: Objects, rays: Rays, surface: Floats, rng: np.random.Generator, hits: _Hits) -> None:
    """Returns inside of crowns, above the surface that stops the ray."""
    for crown in objects.crowns:
        ray, top, bottom = crown.chord(rays)
        floor = np.maximum(bottom, surface[ray])
        z = top - rng.exponential(0.3 * crown.spacing, len(ray))
        while len(ray):
            ends = rng.random(len(ray)) < STOP_IN_CROWN
            inside = z > floor
            hits.add(ray[inside], z[inside], crown.label, ends[inside])
            go_on = inside & ~ends
            ray, floor = ray[go_on], floor[go_on]
            # Two echoes nearer than about half a metre melt into one.
            z = z[go_on] - 0.5 - rng.exponential(crown.spacing - 0.5, len(ray))


def _surface(terrain: Terrain, objects: Objects, rays: Rays, rng: np.random.Generator, hits: _Hits) -> Floats:
    """The opaque end of each ray: a solid, low vegetation or the ground."""
    z = _ground(terrain, rays)
    label = np.full(len(rays), GROUND, np.uint8)
    for patch in objects.shrubs:
        here = rays.near(patch.x, patch.y, float(terrain.height_at(patch.x, patch.y)), patch.radius)
        here = here[(rng.random(len(here)) < 0.5) & (label[here] == GROUND)]
        z[here] += rng.uniform(0.1, patch.height, len(here))
        label[here] = patch.label
    for solid in objects.solids:
        ray, top = solid.hit(rays)
        higher = top > z[ray]
        z[ray[higher]] = top[higher]
        label[ray[higher]] = solid.label
    for value in np.unique(label):
        ray = np.flatnonzero(label == value)
        hits.add(ray, z[ray], int(value), np.ones(len(ray), np.bool_))
    return z


def _numbered(hits: _Hits, max_returns: int) -> tuple[npt.NDArray[np.intp], Floats, UInt8s, UInt8s, UInt8s]:
    """Ray, height, label, return number and count, ordered by ray and from the first return to the last."""
    ray, z = np.concatenate(hits.ray), np.concatenate(hits.z)
    label, last = np.concatenate(hits.label), np.concatenate(hits.last)
    order = np.lexsort((-z, ray))
    ray, z, label, last = ray[order], z[order], label[order], last[order]
    start = np.flatnonzero(np.r_[True, ray[1:] != ray[:-1]])
    length = np.diff(np.r_[start, len(ray)])
    number = np.arange(len(ray)) - np.repeat(start, length) + 1
    ended = np.cumsum(last, dtype=np.intp) - last
    seen = (ended == np.repeat(ended[start], length)) & (number <= max_returns)
    count = np.repeat(np.add.reduceat(seen.astype(np.intp), start), length)
    return ray[seen], z[seen], label[seen], number[seen].astype(np.uint8), count[seen].astype(np.uint8)


def _blunders(
    sensor: AlsSensor, terrain: Terrain, box: Box, rng: np.random.Generator
) -> tuple[Floats, UInt8s]:
    """Points where nothing is: xyz (n, 3) and labels."""
    km2 = (box[2] - box[0]) * (box[3] - box[1]) / 1e6
    low, groups, high = (
        rng.poisson(rate * km2) for rate in (sensor.low_singles_km2, sensor.low_groups_km2, sensor.high_km2)
    )
    members = rng.integers(3, 8, groups)
    n = low + groups + high
    x, y = rng.uniform(box[0], box[2], n), rng.uniform(box[1], box[3], n)
    above = np.r_[-rng.uniform(2, 15, low), -rng.uniform(2, 6, groups), rng.uniform(20, 200, high)]
    times = np.r_[np.ones(low, np.intp), members, np.ones(high, np.intp)]
    spread = np.repeat(np.r_[np.zeros(low), np.full(groups, 0.4), np.zeros(high)], times)
    x, y, above = (np.repeat(column, times) for column in (x, y, above))
    x, y = x + spread * rng.standard_normal(len(x)), y + spread * rng.standard_normal(len(y))
    above = above + 0.2 * spread * rng.standard_normal(len(x))
    label = np.where(above < 0, LOW_NOISE, HIGH_NOISE).astype(np.uint8)
    return np.column_stack((x, y, terrain.height_at(x, y) + above)), label


def scan(
    terrain: Terrain,
    objects: Objects,
    sensor: AlsSensor,
    box: Box,
    rng: np.random.Generator,
) -> Returns:
    """The points of ``box`` (half-open x0, y0, x1, y1 in metres), along scan lines, blunders last.

    Pulses are shot at a slightly larger box, as slanted ones end elsewhere; what falls outside is left to the
    neighbour's own scan, so boxes side by side give each place its density once.
    """
    margin = REACH_M * ((sensor.strip_m + sensor.overlap_m) / 2 / sensor.flying_height_m + FORWARD_TILT)
    wide = (box[0] - margin, box[1] - margin, box[2] + margin, box[3] + margin)
    rays = _pulses(sensor, terrain.base, wide, rng)
    objects = objects.touching(*box, 2 * margin)
    hits = _Hits([], [], [], [])
    surface = _surface(terrain, objects, rays, rng, hits)
    _canopy(objects, rays, surface, rng, hits)
    ray, z, label, number, count = _numbered(hits, sensor.max_returns)
    x, y = rays.at(z, ray)
    angle = np.degrees(np.arctan(rays.lx[ray]))
    noise, noise_label = _blunders(sensor, terrain, box, rng)
    one = np.ones(len(noise))
    z = np.r_[z + sensor.sigma_m * rng.standard_normal(len(z)), noise[:, 2]]
    x, y, label = np.r_[x, noise[:, 0]], np.r_[y, noise[:, 1]], np.r_[label, noise_label]
    inside = (x >= box[0]) & (x < box[2]) & (y >= box[1]) & (y < box[3])
    return Returns(
        np.column_stack((x, y, z))[inside],
        label[inside],
        np.r_[number, one].astype(np.uint8)[inside],
        np.r_[count, one].astype(np.uint8)[inside],
        np.r_[angle, 0.0 * one][inside],
    )
