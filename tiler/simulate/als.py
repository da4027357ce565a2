"""Airborne laser scanner: slanted pulses, several returns, range noise and blunders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from tiler.core.classes import GROUND, HIGH_NOISE, LOW_NOISE, WATER
from tiler.simulate.low_points import clumps, delayed
from tiler.simulate.objects import LOW_VEGETATION, WIRE, Floats, Objects, Rays
from tiler.simulate.points import Box, SimulatedPoints, UInt8s, alone, vegetation_label
from tiler.simulate.randomness import BIAS, BLUNDERS, PULSES, generator, node_normals
from tiler.simulate.site import Site
from tiler.simulate.terrain import Terrain
from tiler.simulate.water_bodies import Waters

PATCH_M = 100.0
"""Side in metres of the squares that are surveyed at once, which bounds the memory.

The squares are a lattice at (0, 0)."""

FORWARD_TILT = 0.02
"""Metres to the north per metre of height, so that walls across the strip get points."""

LINE_STEP = 1.25
"""Ratio of the spacing of scan lines to the spacing of pulses, at constant density."""

SETTLED_M = 1e-5
"""Accuracy in metres with which a hit lies on the terrain."""

REACH_M = 160.0
"""Largest height of surfaces above `Terrain.base`, metres.

It bounds how far pulses lean into the site."""

TALLEST_M = 60.0
"""Largest height of an object above the ground, metres."""

LOST = 0.01
"""Share of pulses that do not return from the surface where they end, except on water."""

WATER_RETURNS = 0.03
"""Share of pulses on water that return."""


@dataclass(frozen=True)
class AlsSensor:
    """Airborne laser scanner. Units are metres, degrees and counts per square kilometre.

    Attributes
    ----------
    density : float
        Pulses per square metre outside of overlaps. Scan lines run along x.
    sigma_m : float
        Standard deviation of the heights. The offset of each strip has 0.3 of this deviation.
    flying_height_m, strip_m, overlap_m : float
        Height above `Terrain.base`, distance of the strips, which run along y, and width of their overlap.
    max_returns : int
        Largest number of returns of a pulse. Later returns are lost.
    low_singles_km2, low_groups_km2, high_km2 : float
        Numbers of blunders: single points 2-15 m below the ground, groups of 3 to 7 points 2-6 m below it, and
        single points 20-200 m above it.
    low_share : float
        Share of the points that lie alone 0.3-8 m below the ground.
    low_clumps_km2 : float
        Number of clumps of 8 to 30 points 1-6 m below the ground.
    mirrors_km2 : float
        Number of rectangles of about 12 x 40 m along streets below which the ground is seen again, mirrored or
        moved by 3-5 m, with 15 to 60 % of the density above.
    """

    BLUNDERS: ClassVar = (
        "low_singles_km2",
        "low_groups_km2",
        "high_km2",
        "low_share",
        "low_clumps_km2",
        "mirrors_km2",
    )
    patch_m: ClassVar[float] = PATCH_M
    coloured: ClassVar[bool] = False
    pulsed: ClassVar[bool] = True

    density: float = 4.0
    sigma_m: float = 0.025
    flying_height_m: float = 900.0
    strip_m: float = 300.0
    overlap_m: float = 20.0
    max_returns: int = 5
    low_singles_km2: float = 150.0
    low_groups_km2: float = 40.0
    high_km2: float = 150.0
    low_share: float = 0.0
    low_clumps_km2: float = 0.0
    mirrors_km2: float = 0.0

    @property
    def reach_m(self) -> float:
        """Distance beyond a site up to which pulses must be aimed to hit all of it, metres."""
        lean = (self.strip_m + self.overlap_m) / 2 / self.flying_height_m + FORWARD_TILT
        return REACH_M * lean

    def survey(self, site: Site, ix: int, iy: int) -> SimulatedPoints:
        """Return the points of the pulses aimed at patch (ix, iy), by pulse, with blunders last.

        A pulse belongs to the patch at which it is aimed, on the level `Terrain.base`. So each
        pulse belongs to one patch, and its points may lie beyond the edge of the patch.
        """
        box = (ix * PATCH_M, iy * PATCH_M, (ix + 1) * PATCH_M, (iy + 1) * PATCH_M)
        rng = generator(site.seed, PULSES, ix, iy)
        rays, strip = _pulses(self, site.terrain.base, box, rng)
        bare = ground_hit(site.terrain, rays)
        px, py = rays.at(bare)
        lean = TALLEST_M * rays.steepest
        objects = site.objects_near(
            px.min() - lean, py.min() - lean, px.max() + lean, py.max() + lean
        )
        hits: Hits = []
        surface = _surface(site, objects, rays, bare, rng, hits)
        _canopy(objects, rays, surface, rng, hits)
        ray, z, label, number, count = _numbered(hits, self.max_returns)
        x, y = rays.at(z, ray)
        label = vegetation_label(label, z - bare[ray])
        angle = np.degrees(np.arctan(rays.lx[ray]))
        bias = (
            0.3
            * self.sigma_m
            * node_normals(site.seed, BIAS, strip[ray], np.zeros(len(ray), np.int64))
        )
        z = z + bias + self.sigma_m * rng.standard_normal(len(z))
        points = SimulatedPoints(np.column_stack((x, y, z)), label, number, count, angle)
        if self.low_share or self.mirrors_km2:
            rates = self.low_share, self.mirrors_km2
            points = delayed(points, site, (ix, iy), *rates, rays, bare, ray)
        parts = [
            points,
            _blunders(self, site.terrain, box, generator(site.seed, BLUNDERS, ix, iy)),
        ]
        if self.low_clumps_km2:
            parts.append(clumps(site, (ix, iy), box, self.low_clumps_km2))
        return SimulatedPoints.joined(parts)


Hits = list[tuple[npt.NDArray[np.intp], Floats, UInt8s, npt.NDArray[np.bool_]]]
"""Returns in any order: index of the ray, height, label, and True if the pulse ends there."""


def _hit(ray: npt.NDArray[np.intp], z: Floats, label: Any, last: Any) -> Any:
    return ray, z, np.full(len(ray), label, np.uint8), np.full(len(ray), last, np.bool_)


def _pulses(
    sensor: AlsSensor, base: float, box: Box, rng: np.random.Generator
) -> tuple[Rays, npt.NDArray[np.int64]]:
    """Return rays through a jittered pattern over ``box`` at ``base``, and the strip of each."""
    across, lap = (sensor.density * LINE_STEP) ** -0.5, sensor.overlap_m / 2
    along = across * LINE_STEP
    lines = (
        np.arange(np.ceil(box[1] / along - 0.5), np.ceil(box[3] / along - 0.5)) + 0.5
    ) * along
    first, last = (
        np.floor((box[0] - lap) / sensor.strip_m),
        np.floor((box[2] + lap) / sensor.strip_m),
    )
    parts, strips = [], []
    for strip in np.arange(first, last + 1):
        west = max(box[0], strip * sensor.strip_m - lap)
        east = min(box[2], (strip + 1) * sensor.strip_m + lap)
        columns = (
            np.arange(np.ceil(west / across - 0.5), np.ceil(east / across - 0.5)) + 0.5
        ) * across
        x, y = (grid.ravel() for grid in np.meshgrid(columns, lines))
        x = x + rng.uniform(-0.3 * across, 0.3 * across, len(x))
        y = y + rng.uniform(-0.2 * along, 0.2 * along, len(y))
        lx = ((strip + 0.5) * sensor.strip_m - x) / sensor.flying_height_m
        parts.append(
            np.stack(
                (x - lx * base, y - FORWARD_TILT * base, lx, np.full(len(x), FORWARD_TILT))
            )
        )
        strips.append(np.full(len(x), int(strip), np.int64))
    ax, ay, lx, ly = np.concatenate(parts, axis=1)
    return Rays(ax, ay, lx, ly, base), np.concatenate(strips)


def ground_hit(terrain: Terrain, rays: Rays) -> Floats:
    """Return the height in metres at which each ray meets the terrain.

    A fixed-point iteration converges where rays are much steeper than slopes. Bisection finds
    the height of the other rays, which meet cliffs.
    """
    z = terrain.height_at(*rays.at(np.full(len(rays), terrain.base)))
    rest = np.arange(len(rays))
    for _ in range(11):
        before = z[rest]
        z[rest] = terrain.height_at(*rays.at(before, rest))
        rest = rest[np.abs(z[rest] - before) > SETTLED_M]
        if not len(rest):
            return z
    low = np.full(len(rest), terrain.base - 2 * REACH_M)
    high = np.full(len(rest), terrain.base + 2 * REACH_M)
    for _ in range(50):
        middle = (low + high) / 2
        above = middle > terrain.height_at(*rays.at(middle, rest))
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    z[rest] = (low + high) / 2
    return z


def _canopy(
    objects: Objects, rays: Rays, surface: Floats, rng: np.random.Generator, hits: Hits
) -> None:
    """Append the returns from wires and crowns above the surface at which each ray ends."""
    for wire in objects.wires:
        ray, z = wire.hit(rays)
        seen = z > surface[ray]
        hits.append(_hit(ray[seen], z[seen], WIRE, False))
    for crown in objects.crowns:
        ray, top, bottom = crown.chord(rays)
        floor = np.maximum(bottom, surface[ray])
        z = top - rng.exponential(0.3 * crown.spacing, len(ray))
        while len(ray):
            ends = rng.random(len(ray)) < crown.stop
            inside = z > floor
            hits.append(_hit(ray[inside], z[inside], LOW_VEGETATION, ends[inside]))
            go_on = inside & ~ends
            ray, floor = ray[go_on], floor[go_on]
            # Two echoes within half a metre merge into one.
            z = z[go_on] - 0.5 - rng.exponential(max(crown.spacing - 0.5, 0.1), len(ray))


def _surface(
    site: Site, objects: Objects, rays: Rays, bare: Floats, rng: np.random.Generator, hits: Hits
) -> Floats:
    """Append the last returns, and return the height at which each ray ends.

    A ray ends on a solid, a plant, water or the ground. Some rays have no return from there.
    """
    z = bare.copy()
    px, py = rays.at(bare)
    label = np.where(site.terrain.wet_at(px, py), WATER, GROUND).astype(np.uint8)
    for patch in objects.patches:
        here = np.flatnonzero(
            (np.abs(px - patch.x) <= patch.radius) & (np.abs(py - patch.y) <= patch.radius)
        )
        depth = patch.inside(px[here], py[here])
        here = here[
            (depth > 0) & (rng.random(len(here)) < patch.cover) & (label[here] == GROUND)
        ]
        # Most echoes come from the middle of a plant's height. A low plant and the ground below
        # it give one echo between the two.
        tall = 0.08 + (patch.height - 0.08) * rng.beta(1.6, 1.6, len(here))
        double = (tall > 0.7) & (rng.random(len(here)) < 0.4)
        hits.append(
            _hit(here[double], bare[here[double]] + tall[double], LOW_VEGETATION, False)
        )
        here, tall = here[~double], tall[~double]
        z[here], label[here] = bare[here] + tall, LOW_VEGETATION
    for solid in objects.solids:
        ray, top = solid.hit(rays)
        higher = top > z[ray]
        z[ray[higher]], label[ray[higher]] = top[higher], solid.label
    draw = rng.random(len(rays))
    lost = np.where(label == WATER, 1.0 - WATER_RETURNS, LOST)
    if site.terrain.waters is not None:
        lost = _on_waters(site.terrain.waters, (px, py), z, label, lost, rng)
    ray = np.flatnonzero(draw >= lost)
    hits.append(_hit(ray, z[ray], label[ray], True))
    return z


def _on_waters(
    waters: Waters,
    at: tuple[Floats, Floats],
    z: Floats,
    label: UInt8s,
    lost: Floats,
    rng: np.random.Generator,
) -> Floats:
    """Return the share of lost pulses at each position. Set heights and labels of returns from water in place."""
    x, y = at
    if waters.lost_on_land is not None:
        lost = np.where(label == GROUND, waters.lost_on_land(x, y), lost)
    wet = np.flatnonzero(label == WATER)
    index = waters.body_at(x[wet], y[wet])
    for i, body in enumerate(waters.bodies):
        here = wet[index == i]
        place = x[here], y[here]
        lost[here] = 1.0 - body.returned(*place)
        z[here] += body.tide_m(*place) + body.waves_m(*place) * rng.standard_normal(len(here))
        reed = here[rng.random(len(here)) < body.reeds(*place)]
        z[reed] += rng.uniform(0.3, 2.0, len(reed))
        label[reed], lost[reed] = LOW_VEGETATION, 0.0
        deep = here[rng.random(len(here)) < body.low]
        z[deep] -= rng.uniform(1.0, 3.0, len(deep))
        label[deep], lost[deep] = LOW_NOISE, 0.0
    return lost


def _numbered(
    hits: Hits, max_returns: int
) -> tuple[npt.NDArray[np.intp], Floats, UInt8s, UInt8s, UInt8s]:
    """Return ray, height, label, return number and count, in the order of rays and returns."""
    ray, z, label, last = (np.concatenate(column) for column in zip(*hits, strict=True))
    order = np.lexsort((-z, ray))
    ray, z, label, last = ray[order], z[order], label[order], last[order]
    start = np.flatnonzero(np.r_[True, ray[1:] != ray[:-1]])
    length = np.diff(np.r_[start, len(ray)])
    number = np.arange(len(ray)) - np.repeat(start, length) + 1
    ended = np.cumsum(last, dtype=np.intp) - last
    seen = (ended == np.repeat(ended[start], length)) & (number <= max_returns)
    count = np.repeat(np.add.reduceat(seen.astype(np.intp), start), length)
    return (
        ray[seen],
        z[seen],
        label[seen],
        number[seen].astype(np.uint8),
        count[seen].astype(np.uint8),
    )


def _blunders(
    sensor: AlsSensor, terrain: Terrain, box: Box, rng: np.random.Generator
) -> SimulatedPoints:
    """Return points below the ground and in the air."""
    km2 = (box[2] - box[0]) * (box[3] - box[1]) / 1e6
    low, groups, high = (
        rng.poisson(rate * km2)
        for rate in (sensor.low_singles_km2, sensor.low_groups_km2, sensor.high_km2)
    )
    members = rng.integers(3, 8, groups)
    n = low + groups + high
    x, y = rng.uniform(box[0], box[2], n), rng.uniform(box[1], box[3], n)
    above = np.r_[
        -rng.uniform(2, 15, low), -rng.uniform(2, 6, groups), rng.uniform(20, 200, high)
    ]
    times = np.r_[np.ones(low, np.intp), members, np.ones(high, np.intp)]
    spread = np.repeat(np.r_[np.zeros(low), np.full(groups, 0.4), np.zeros(high)], times)
    x, y, above = (np.repeat(column, times) for column in (x, y, above))
    x, y = x + spread * rng.standard_normal(len(x)), y + spread * rng.standard_normal(len(y))
    above = above + 0.2 * spread * rng.standard_normal(len(x))
    label = np.where(above < 0, LOW_NOISE, HIGH_NOISE).astype(np.uint8)
    return alone(np.column_stack((x, y, terrain.height_at(x, y) + above)), label)
