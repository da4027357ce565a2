"""Dense image matching: a surface with correlated noise, facades, blunders and colours.

Plants hide the ground below them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import ndimage
from scipy.special import ndtri

from ptd.arrays import Bool, Float64, UInt8
from tiler.core.points import GROUND, HIGH_NOISE, LOW_NOISE, WATER
from tiler.simulate.matched_surface import (
    PIXEL_M,
    SHADOW_REACH_M,
    MatchedSurface,
    colours,
    render_surface,
    shadows,
)
from tiler.simulate.objects import BUILDING, LOW_VEGETATION
from tiler.simulate.points import Box, SimulatedPoints
from tiler.simulate.randomness import BIAS, BLUNDERS, MATCHES, TEXTURE, generator, smooth_noise
from tiler.simulate.site import Site

PATCH_M = 50.0
"""Side in metres of the squares that are matched at once, which bounds the memory.

The squares are a lattice at (0, 0)."""

CLUMP = (5, 30)
"""Smallest and largest number of points in a clump of blunders."""

WALL_M = 2.5
"""Smallest jump of the surface that is a visible wall, metres."""

NARROW_M = 1.2
"""Half the side in metres of the window around a position, in which high objects hide it from
images."""

NARROW_RISE_M = 7.0
"""Height in metres above a position from which an object next to it hides it from images."""

TEXTURE_M = 5.0
"""Size in metres of the patches of ground, water and roofs without texture."""


@dataclass(frozen=True)
class DimSensor:
    """Settings of image matching, in metres and shares.

    Attributes
    ----------
    density : float
        Points per square metre of open ground.
    sigma_m : float
        Standard deviation of heights on ground, water and buildings. It is doubled on plants and other objects.
    correlated : float
        Share of the variance that is common to neighbouring points.
    correlation_m : float
        Distance up to which errors of neighbouring points are correlated.
    edge_m : float
        Standard deviation of the smoothing at edges.
    facade : float
        Ratio of the density of points on well visible walls to the density on open ground.
    blunders : float
        Share of points below the ground. Half of them are single points, half are in clumps of 5 to 30.
    high_blunders : float
        Share of points in the air.
    shadow : float
        Factor of the standard deviation of heights in shadow.
    textureless, textureless_share : float
        Factor of the standard deviation on ground, water and roofs without texture, and their share of the area.
    tails : float or None
        Degrees of freedom (above 2) of Student's t for the independent noise of a point. None gives normal noise.
    jitter : float
        Range of the random offsets from a square lattice, as a share of its spacing. With 0, points are regular.
    plants_m : float
        Height below which plants are classified as ground.
    coloured : bool
    """

    BLUNDERS: ClassVar = ("blunders", "high_blunders")
    patch_m: ClassVar[float] = PATCH_M
    reach_m: ClassVar[float] = 0.0
    pulsed: ClassVar[bool] = False

    density: float = 40.0
    sigma_m: float = 0.066
    correlated: float = 0.4
    correlation_m: float = 1.5
    edge_m: float = 0.3
    facade: float = 0.25
    blunders: float = 5e-4
    high_blunders: float = 3e-5
    shadow: float = 1.3
    textureless: float = 2.0
    textureless_share: float = 0.0
    tails: float | None = None
    jitter: float = 1.0
    plants_m: float = 0.0
    coloured: bool = True

    def survey(self, site: Site, ix: int, iy: int) -> SimulatedPoints:
        """Return the points of patch (ix, iy): first the surface, then facades, then blunders."""
        box = (ix * PATCH_M, iy * PATCH_M, (ix + 1) * PATCH_M, (iy + 1) * PATCH_M)
        rng = generator(site.seed, MATCHES, ix, iy)
        skin = render_surface(site, box, SHADOW_REACH_M + 2.0, self.edge_m)
        dark = shadows(skin)
        xyz, label = self._matches(skin, dark, site, box, rng)
        wall = self._facades(skin, box, rng)
        noise, noise_label = self._blunders(
            site, skin, box, generator(site.seed, BLUNDERS, ix, iy)
        )
        facade = np.repeat([False, True, False], (len(xyz), len(wall), len(noise)))
        xyz = np.concatenate((xyz, wall, noise))
        label = np.r_[label, np.full(len(wall), BUILDING, np.uint8), noise_label]
        node = skin.nearest(xyz[:, 0], xyz[:, 1])
        rgb = None
        if self.coloured:
            rgb = colours(
                site, xyz[:, 0], xyz[:, 1], label, skin.thing[node], facade, dark[node], rng
            )
        one = np.ones(len(xyz), np.uint8)
        return SimulatedPoints(xyz, label, one, one.copy(), np.zeros(len(xyz)), rgb)

    def _matches(
        self,
        skin: MatchedSurface,
        dark: Bool,
        site: Site,
        box: Box,
        rng: np.random.Generator,
    ) -> tuple[Float64, UInt8]:
        """Return xyz and labels of points of the surface.

        Points are fewer in shadow, in narrow yards and on water.
        """
        count = round(PATCH_M * self.density**0.5)
        step = PATCH_M / count
        row, column = np.divmod(np.arange(count * count), count)
        low, high = 0.5 - self.jitter / 2, 0.5 + self.jitter / 2
        x = box[0] + (column + rng.uniform(low, high, len(row))) * step
        y = box[1] + (row + rng.uniform(low, high, len(row))) * step
        node = skin.nearest(x, y)
        around = 2 * round(NARROW_M / PIXEL_M) + 1
        narrow = (
            ndimage.maximum_filter(skin.sharp, around)[node] - skin.sharp[node] > NARROW_RISE_M
        )
        lost = 0.02 + 0.2 * dark[node] + 0.4 * narrow + 0.8 * (skin.label[node] == WATER)
        keep = rng.random(len(x)) >= lost
        x, y, node = x[keep], y[keep], (node[0][keep], node[1][keep])
        label = skin.labels(x, y)
        above = np.maximum(skin.sharp - skin.bare, skin.rise)[node]
        label[(label == LOW_VEGETATION) & (above < self.plants_m)] = GROUND
        z = skin.height(x, y) + self._noise(site, x, y, label, dark[node], rng)
        return np.column_stack((x, y, z)), label

    def _noise(
        self,
        site: Site,
        x: Float64,
        y: Float64,
        label: UInt8,
        shaded: Bool,
        rng: np.random.Generator,
    ) -> Float64:
        """Return errors of heights in metres, the sum of a correlated and an independent part."""
        hard = np.isin(label, (GROUND, WATER, BUILDING))
        sigma = self.sigma_m * np.where(hard, 1.0, 2.0) * np.where(shaded, self.shadow, 1.0)
        if self.textureless_share:
            plain = smooth_noise(site.seed, TEXTURE, x, y, TEXTURE_M) > ndtri(
                1.0 - self.textureless_share
            )
            sigma = sigma * np.where(hard & plain, self.textureless, 1.0)
        common = smooth_noise(site.seed, BIAS, x, y, self.correlation_m)
        if self.tails is None:
            own = rng.standard_normal(len(x))
        else:
            own = rng.standard_t(self.tails, len(x)) * np.sqrt((self.tails - 2.0) / self.tails)
        return np.asarray(
            sigma * (self.correlated**0.5 * common + (1.0 - self.correlated) ** 0.5 * own)
        )

    def _facades(self, skin: MatchedSurface, box: Box, rng: np.random.Generator) -> Float64:
        """Return xyz (n, 3) of points on walls, where the surface falls from a building."""
        x, y = skin.positions()
        parts = [np.empty((0, 3))]
        rate = self.facade * self.density * PIXEL_M
        for axis, way in ((0, 1), (0, -1), (1, 1), (1, -1)):
            lower = np.roll(skin.sharp, -way, axis)
            jump = skin.sharp - lower
            # Images show some sides of a building better than others.
            seen = skin.thing * 4 + axis * 2 + (way > 0)
            share = np.array([1.0, 0.15, 0.5, 0.05, 0.8])[seen % 5]
            at = (skin.thing >= 0) & (skin.label == BUILDING) & (jump > WALL_M)
            at &= (x >= box[0]) & (x < box[2]) & (y >= box[1]) & (y < box[3])
            times = rng.poisson(rate * share[at] * jump[at])
            wx, wy, top, fall = (
                np.repeat(raster[at], times) for raster in (x, y, skin.sharp, jump)
            )
            offset = PIXEL_M * (0.5 * way + rng.uniform(-0.1, 0.3, len(wx)))
            slide = PIXEL_M * rng.uniform(-0.5, 0.5, len(wx))
            dx, dy = slide, offset
            if axis:
                dx, dy = offset, slide
            wx, wy = wx + dx, wy + dy
            # Matching finds more points on the upper part of a wall than near its foot.
            z = (
                top
                - fall * rng.beta(1.0, 1.4, len(wx))
                + self.sigma_m * rng.standard_normal(len(wx))
            )
            parts.append(np.column_stack((wx, wy, z)))
        points = np.concatenate(parts)
        inside = (points[:, :2] >= box[:2]) & (points[:, :2] < box[2:])
        return points[inside.all(axis=1)]

    def _blunders(
        self, site: Site, skin: MatchedSurface, box: Box, rng: np.random.Generator
    ) -> tuple[Float64, UInt8]:
        """Return points below the ground and in the air: xyz (n, 3) in metres and labels."""
        points = self.density * PATCH_M**2
        alone = rng.poisson(points * self.blunders / 2)
        clumps = rng.poisson(points * self.blunders / 2 / np.mean(CLUMP))
        high = rng.poisson(points * self.high_blunders)
        size = rng.integers(CLUMP[0], CLUMP[1] + 1, clumps)
        n = alone + clumps + high
        x, y = rng.uniform(box[0], box[2], n), rng.uniform(box[1], box[3], n)
        deep = -np.exp(rng.uniform(np.log(0.6), np.log(8.0), alone + clumps))
        above = np.r_[deep, rng.uniform(3.0, 40.0, high)]
        times = np.r_[np.ones(alone, np.intp), size, np.ones(high, np.intp)]
        spread = np.repeat(
            np.r_[np.zeros(alone), rng.uniform(0.15, 0.7, clumps), np.zeros(high)], times
        )
        label = np.repeat(np.where(above < 0, LOW_NOISE, HIGH_NOISE), times).astype(np.uint8)
        x, y, above = (np.repeat(column, times) for column in (x, y, above))
        x, y = (
            x + spread * rng.standard_normal(len(x)),
            y + spread * rng.standard_normal(len(y)),
        )
        x, y = np.clip(x, box[0], box[2] - 0.001), np.clip(y, box[1], box[3] - 0.001)
        above = above + 0.25 * spread * rng.standard_normal(len(x))
        # Blunders closer than 0.4 m to the ground would be noise of the ground.
        above = np.where(label == LOW_NOISE, np.minimum(above, -0.4), above)
        start = np.where(label == LOW_NOISE, site.terrain.height_at(x, y), skin.height(x, y))
        return np.column_stack((x, y, start + above)), label
