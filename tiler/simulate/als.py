"""Airborne laser scanner: slanted pulses, several returns, range noise and blunders.

A raw scan also has low points: single ones of every depth, clumps and mirrored planes. They come last.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ptd.arrays import Bool, Float64, Indices, Int64, UInt8
from tiler.core.points import GROUND, HIGH_NOISE, LOW_NOISE, WATER
from tiler.simulate.objects import LOW_VEGETATION, WIRE, Objects, Rays
from tiler.simulate.points import Box, SimulatedPoints, alone, vegetation_label
from tiler.simulate.randomness import (
    BIAS,
    BLUNDERS,
    CLUMPS,
    LATE,
    MIRRORS,
    PULSES,
    generator,
    node_normals,
)
from tiler.simulate.site import Site
from tiler.simulate.terrain import Line, Terrain, Waters

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
            points = _delayed(points, site, (ix, iy), *rates, rays, bare, ray)
        parts = [
            points,
            _blunders(self, site.terrain, box, generator(site.seed, BLUNDERS, ix, iy)),
        ]
        if self.low_clumps_km2:
            parts.append(clumps(site, (ix, iy), box, self.low_clumps_km2))
        return SimulatedPoints.joined(parts)


Hits = list[tuple[Indices, Float64, UInt8, Bool]]
"""Returns in any order: index of the ray, height, label, and True if the pulse ends there."""


def _hit(ray: Indices, z: Float64, label: Any, last: Any) -> Any:
    return ray, z, np.full(len(ray), label, np.uint8), np.full(len(ray), last, np.bool_)


def _pulses(
    sensor: AlsSensor, base: float, box: Box, rng: np.random.Generator
) -> tuple[Rays, Int64]:
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


def ground_hit(terrain: Terrain, rays: Rays) -> Float64:
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
    objects: Objects, rays: Rays, surface: Float64, rng: np.random.Generator, hits: Hits
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
    site: Site,
    objects: Objects,
    rays: Rays,
    bare: Float64,
    rng: np.random.Generator,
    hits: Hits,
) -> Float64:
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
    at: tuple[Float64, Float64],
    z: Float64,
    label: UInt8,
    lost: Float64,
    rng: np.random.Generator,
) -> Float64:
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


def _numbered(hits: Hits, max_returns: int) -> tuple[Indices, Float64, UInt8, UInt8, UInt8]:
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


SINGLE_DEPTH_M = (0.3, 8.0)
"""Depths of single points below the ground, metres. Their logarithm is uniform."""

CLUMP_POINTS = (8, 30)
CLUMP_DIAMETER_M = (1.0, 2.0)
CLUMP_DEPTH_M = (1.0, 6.0)
CLUMP_HEIGHT_M = 0.6
"""Limits of the number, diameter and depth of the points of a clump, and its height, metres."""

MIRROR_LENGTH_M = (30.0, 45.0)
MIRROR_WIDTH_M = (9.0, 14.0)
MIRROR_DEPTH_M = (3.0, 5.0)
"""Limits of the sides of a mirrored plane, and of its depth at the centre, metres."""
MIRROR_DENSITY = (0.15, 0.6)
"""Density of a mirrored plane relative to that of the ground that remains above it."""
MIRROR_SIGMA_M = (0.03, 0.08)
"""Standard deviation of the heights of a mirrored plane, metres."""


@dataclass(frozen=True)
class Mirror:
    """Rectangle in which a share of the pulses return late, as from a plane below the ground.

    A mirror image on a slope may come near the ground. Pulses that would return from less than
    0.3 m below it are not late.

    Attributes
    ----------
    line : Line
        Centre and direction of the length.
    length_m, width_m : float
    depth_m : float
        Depth below the ground at the centre, metres.
    density : float
        Density of the plane relative to that of the ground that remains above it.
    sigma_m : float
        Standard deviation of the heights, metres.
    rise : int
        2 if the plane is the mirror image of the ground, which falls where the ground rises, or 0 if it
        is parallel to the ground.
    """

    line: Line
    length_m: float
    width_m: float
    depth_m: float
    density: float
    sigma_m: float
    rise: int

    def inside(self, x: Float64, y: Float64) -> Bool:
        """Return a mask of the positions (metres) in the rectangle."""
        along, across = self.line.along_across(x, y)
        return np.asarray(
            (np.abs(along) < self.length_m / 2) & (np.abs(across) < self.width_m / 2)
        )


def mirrors_near(site: Site, per_km2: float, box: Box) -> list[Mirror]:
    """Return the mirrors that may reach into a box (metres).

    A square kilometre has ``per_km2`` of them on average. Each belongs to a block of the site
    and lies along its south or west edge, where streets are. So a mirror depends only on the
    site, the rate and its block.
    """
    reach = float(np.hypot(MIRROR_LENGTH_M[1], MIRROR_WIDTH_M[1])) / 2
    west, south = (int(np.floor((edge - reach) / site.block_m)) for edge in box[:2])
    east, north = (int(np.floor((edge + reach) / site.block_m)) for edge in box[2:])
    mirrors = []
    for iy in range(south, north + 1):
        for ix in range(west, east + 1):
            rng = generator(site.seed, MIRRORS, ix, iy)
            for _ in range(rng.poisson(per_km2 * site.block_m**2 / 1e6)):
                mirrors.append(_mirror(rng, ix * site.block_m, iy * site.block_m, site.block_m))
    return mirrors


def _mirror(rng: np.random.Generator, west: float, south: float, block_m: float) -> Mirror:
    edge = Line(west, south, float(rng.choice([0.0, 90.0])))
    centre = edge.at(rng.uniform(0.0, block_m))
    return Mirror(
        Line(*centre, edge.angle_deg),
        length_m=rng.uniform(*MIRROR_LENGTH_M),
        width_m=rng.uniform(*MIRROR_WIDTH_M),
        depth_m=rng.uniform(*MIRROR_DEPTH_M),
        density=rng.uniform(*MIRROR_DENSITY),
        sigma_m=rng.uniform(*MIRROR_SIGMA_M),
        rise=int(rng.choice([0, 2])),
    )


def _delayed(
    points: SimulatedPoints,
    site: Site,
    index: tuple[int, int],
    single_share: float,
    mirrors_km2: float,
    rays: Rays,
    bare: Float64,
    ray: Indices,
) -> SimulatedPoints:
    """Return the points of a patch with some last returns moved below the ground.

    An echo on a detour is late, so it seems to come from farther along the ray. The depth is
    exact below the ground at the point's own position.

    Parameters
    ----------
    points : SimulatedPoints
    site : Site
    index : (int, int)
        Patch.
    single_share : float
        Single low points, as a share of all points.
    mirrors_km2 : float
        Number of mirrors per square kilometre. Only returns from open ground are mirrored.
    rays : Rays
    bare : float64, shape (rays,)
        Height at which each ray meets the ground, metres.
    ray : intp, shape (n,)
        Index of the ray of each point.
    """
    last = np.flatnonzero(points.number == points.count)
    if not len(last):
        return points
    rng = generator(site.seed, LATE, *index)
    depth = np.full(len(last), np.nan)
    single = rng.random(len(last)) < single_share * len(points) / len(last)
    low, high = np.log(SINGLE_DEPTH_M)
    depth[single] = np.exp(rng.uniform(low, high, int(single.sum())))
    height = bare[ray[last]]
    x, y = rays.at(height, ray[last])
    street = (points.label[last] == GROUND) & ~single
    for mirror in mirrors_near(site, mirrors_km2, (x.min(), y.min(), x.max(), y.max())):
        here = np.flatnonzero(street & mirror.inside(x, y))
        street[here] = False  # Where mirrors overlap, the first one counts.
        here = here[rng.random(len(here)) < mirror.density / (1.0 + mirror.density)]
        level = site.terrain.height_at(mirror.line.x, mirror.line.y)
        depth[here] = mirror.depth_m + mirror.rise * (height[here] - level)
        depth[here] += mirror.sigma_m * rng.standard_normal(len(here))
    late = np.flatnonzero(depth >= SINGLE_DEPTH_M[0])
    depth, at = depth[late], last[late]
    x, y = rays.at(height[late] - depth, ray[at])
    xyz, label = points.xyz.copy(), points.label.copy()
    xyz[at] = np.column_stack((x, y, site.terrain.height_at(x, y) - depth))
    label[at] = LOW_NOISE
    return replace(points, xyz=xyz, label=label)


def clumps(site: Site, index: tuple[int, int], box: Box, per_km2: float) -> SimulatedPoints:
    """Return the points of the clumps around the centres in a patch, each the only return.

    Parameters
    ----------
    site : Site
    index : (int, int)
        Patch.
    box : Box
        Extent of the patch, metres.
    per_km2 : float
        Number of clumps per square kilometre.
    """
    rng = generator(site.seed, CLUMPS, *index)
    number = rng.poisson(per_km2 * (box[2] - box[0]) * (box[3] - box[1]) / 1e6)
    members = rng.integers(CLUMP_POINTS[0], CLUMP_POINTS[1] + 1, number)
    thick = CLUMP_HEIGHT_M / 2
    columns = (
        rng.uniform(box[0], box[2], number),
        rng.uniform(box[1], box[3], number),
        rng.uniform(*CLUMP_DIAMETER_M, number) / 2,
        rng.uniform(CLUMP_DEPTH_M[0] + thick, CLUMP_DEPTH_M[1] - thick, number),
    )
    x, y, radius, depth = (np.repeat(column, members) for column in columns)
    turn, share = rng.uniform(0, 2 * np.pi, len(x)), np.sqrt(rng.random(len(x)))
    x, y = x + radius * share * np.cos(turn), y + radius * share * np.sin(turn)
    z = site.terrain.height_at(x, y) - depth + rng.uniform(-thick, thick, len(x))
    return alone(np.column_stack((x, y, z)), np.full(len(x), LOW_NOISE, np.uint8))
