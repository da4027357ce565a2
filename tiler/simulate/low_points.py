"""Low points of raw laser scans: single ones of every depth, clumps and mirrored planes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tiler.core.classes import GROUND, LOW_NOISE
from tiler.simulate.objects import Floats, Rays
from tiler.simulate.points import Box, SimulatedPoints, alone
from tiler.simulate.randomness import CLUMPS, LATE, MIRRORS, generator
from tiler.simulate.site import Site
from tiler.simulate.terrain import Line

Indices = npt.NDArray[np.intp]

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

    def inside(self, x: Floats, y: Floats) -> npt.NDArray[np.bool_]:
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


def delayed(
    points: SimulatedPoints,
    site: Site,
    index: tuple[int, int],
    single_share: float,
    mirrors_km2: float,
    rays: Rays,
    bare: Floats,
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
