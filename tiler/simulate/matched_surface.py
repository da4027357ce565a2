"""Surface of a site for image matching: one height per pixel, smoothed at jumps, and its colours.

Colours come from materials, their variation, and shadows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ptd.arrays import AnyArray, Bool, Float64, Indices, Int64, UInt8, UInt16
from tiler.core.points import GROUND, WATER
from tiler.simulate.objects import (
    BRIDGE,
    BUILDING,
    HIGH_VEGETATION,
    LOW_VEGETATION,
    MEDIUM_VEGETATION,
    Rays,
    Solid,
)
from tiler.simulate.points import Box, vegetation_label
from tiler.simulate.randomness import COLOUR, RELIEF, node_normals, smooth_noise
from tiler.simulate.site import Site

PIXEL_M = 0.25
"""Side of a pixel in metres. The lattice of the pixels starts at (0, 0)."""

SMEARED_M = 0.2
"""Rise in metres by smoothing above which ground belongs to the nearest object."""


@dataclass(frozen=True)
class MatchedSurface:
    """Rasters of the surface, with rows from south to north, and with a common shape.

    Attributes
    ----------
    x0, y0 : float
        Position of the node (0, 0), metres.
    bare : float64
        The terrain, metres.
    sharp, smooth : float64
        The surface with objects, before and after smoothing, metres.
    label, beside : uint8
        ASPRS class before smoothing. ``beside`` has the class of the nearest object instead of ground and water.
    rise : float64
        Height by which objects lift the smoothed surface, metres.
    thing : int64
        `solid_number` of the visible solid, or -1 if there is none.
    """

    x0: float
    y0: float
    bare: Float64
    sharp: Float64
    smooth: Float64
    label: UInt8
    beside: UInt8
    rise: Float64
    thing: Int64

    def nearest(self, x: Float64, y: Float64) -> tuple[Indices, Indices]:
        """Return the row and column of the node nearest to each position in metres."""
        row = np.rint((y - self.y0) / PIXEL_M).astype(np.intp)
        column = np.rint((x - self.x0) / PIXEL_M).astype(np.intp)
        return row, column

    def height(self, x: Float64, y: Float64) -> Float64:
        """Return the smoothed height in metres at each position, interpolated bilinearly."""
        return self._between(self.smooth, x, y)

    def labels(self, x: Float64, y: Float64) -> UInt8:
        """Return the class of the surface at each position.

        Ground or water that is lifted by smoothing has the class of the nearest object.
        """
        node = self.nearest(x, y)
        label = self.label[node]
        lifted = np.isin(label, (GROUND, WATER)) & (self._between(self.rise, x, y) > SMEARED_M)
        return np.asarray(np.where(lifted, self.beside[node], label))

    def _between(self, raster: Float64, x: Float64, y: Float64) -> Float64:
        place = np.stack(((y - self.y0) / PIXEL_M, (x - self.x0) / PIXEL_M))
        return np.asarray(ndimage.map_coordinates(raster, place, order=1, mode="nearest"))

    def positions(self) -> tuple[Float64, Float64]:
        """Return x and y of all nodes in metres, in the shape of the rasters."""
        rows, columns = self.bare.shape
        x, y = np.meshgrid(
            self.x0 + PIXEL_M * np.arange(columns), self.y0 + PIXEL_M * np.arange(rows)
        )
        return x, y


def render_surface(site: Site, box: Box, margin_m: float, edge_m: float) -> MatchedSurface:
    """Return the surface of a box with a margin.

    Parameters
    ----------
    site : Site
    box : (x0, y0, x1, y1), metres
    margin_m : float
        Margin for smoothing and shadows, metres.
    edge_m : float
        Standard deviation of the smoothing, metres.
    """
    low = [int(np.floor((edge - margin_m) / PIXEL_M)) for edge in box[:2]]
    high = [int(np.ceil((edge + margin_m) / PIXEL_M)) for edge in box[2:]]
    x, y = np.meshgrid(
        np.arange(low[0], high[0] + 1) * PIXEL_M, np.arange(low[1], high[1] + 1) * PIXEL_M
    )
    bare = site.terrain.height_at(x, y)
    flat: tuple[AnyArray, ...] = _covered(site, x.ravel(), y.ravel(), bare.ravel())
    sharp, label, thing = (column.reshape(bare.shape) for column in flat)
    sigma = edge_m / PIXEL_M
    smooth = ndimage.gaussian_filter(sharp, sigma, mode="nearest")
    rise = smooth - ndimage.gaussian_filter(bare, sigma, mode="nearest")
    beside = _nearest_object(label)
    rasters = {"bare": bare, "sharp": sharp, "smooth": smooth, "rise": rise}
    x0, y0 = low[0] * PIXEL_M, low[1] * PIXEL_M
    return MatchedSurface(x0, y0, label=label, beside=beside, thing=thing, **rasters)


def solid_number(solid: Solid) -> int:
    """Return a non-negative number that depends only on the position of a solid."""
    return int(
        (round(solid.x * 100) * 73856093 ^ round(solid.y * 100) * 19349663) & (2**40 - 1)
    )


def _covered(site: Site, x: Float64, y: Float64, bare: Float64) -> tuple[Float64, UInt8, Int64]:
    """Return height, label and `solid_number` of the topmost surface at each position."""
    z = bare.copy()
    label = np.where(site.terrain.wet_at(x, y), WATER, GROUND).astype(np.uint8)
    thing = np.full(len(x), -1, np.int64)
    objects = site.objects_near(x.min(), y.min(), x.max(), y.max())
    lumps = smooth_noise(site.seed, RELIEF, x, y, 0.8) + 0.7 * smooth_noise(
        site.seed, RELIEF, x, y, 2.6
    )
    for patch in objects.patches:
        here = np.flatnonzero(
            (np.abs(x - patch.x) <= patch.radius) & (np.abs(y - patch.y) <= patch.radius)
        )
        depth = patch.inside(x[here], y[here])
        # Between sparse plants, image matching finds the ground.
        share = np.clip(patch.cover + 0.35 * lumps[here], 0.0, 1.0) * np.clip(
            4.0 * depth, 0.0, 1.0
        )
        tall = 0.8 * patch.height * share
        here, tall = here[tall > 0.1], tall[tall > 0.1]
        higher = (bare[here] + tall > z[here]) & (label[here] != WATER)
        here = here[higher]
        z[here], label[here] = bare[here] + tall[higher], LOW_VEGETATION
    none = np.zeros(len(x))
    rays = Rays(x, y, none, none)
    for solid in objects.solids:
        ray, top = solid.hit(rays)
        ray, top = ray[top > z[ray]], top[top > z[ray]]
        z[ray], label[ray], thing[ray] = top, solid.label, solid_number(solid)
    for crown in objects.crowns:
        ray, top, bottom = crown.chord(rays)
        # Image matching finds a crown as a lumpy dome, without its lower half.
        top = top - 0.15 * (top - bottom) * np.abs(lumps[ray])
        ray, top = ray[top > z[ray]], top[top > z[ray]]
        z[ray], label[ray], thing[ray] = top, LOW_VEGETATION, -1
    return z, vegetation_label(label, z - bare), thing


def _nearest_object(label: UInt8) -> UInt8:
    """Return the class of the nearest node that is not ground or water.

    Labels do not change if there is no such node.
    """
    low = np.isin(label, (GROUND, WATER))
    if low.all():
        return label
    nearest = ndimage.distance_transform_edt(low, return_distances=False, return_indices=True)
    return np.asarray(label[tuple(nearest)])


SUN_ELEVATION_DEG = 48.0
SUN_STEP = (-2, -3)
"""Rows and columns of one step towards the sun, which is in the south-west."""

SHADOW_REACH_M = 30.0
"""Length in metres at which shadows are cut off."""

SHADE = np.array([0.36, 0.40, 0.50])
"""Factors of red, green and blue in shadow, where light comes only from the sky."""

ASPHALT, LAWN, SOIL, ROCK, WATERS, LEAVES, PLANTS, CONCRETE, FACADE = range(9)
MATERIALS = np.array(
    [
        (118, 117, 116),
        (104, 132, 72),
        (152, 130, 102),
        (140, 133, 124),
        (52, 70, 72),
        (62, 86, 44),
        (92, 112, 58),
        (156, 153, 147),
        (176, 166, 150),
    ],
    dtype=np.float64,
)
"""8-bit red, green and blue of the materials."""

ROOFS = np.array(
    [
        (164, 92, 74),
        (140, 82, 68),
        (122, 118, 116),
        (84, 84, 88),
        (178, 172, 162),
        (128, 104, 88),
    ],
    dtype=np.float64,
)
PAINTS = np.array(
    [
        (200, 200, 202),
        (40, 42, 46),
        (120, 124, 130),
        (150, 40, 38),
        (44, 66, 120),
        (225, 225, 220),
    ],
    dtype=np.float64,
)


def ground_materials(site: Site, x: Float64, y: Float64) -> Indices:
    """Return the material of open ground: asphalt along blocks, rock if steep, lawn or soil."""
    step = 0.5
    rise = np.hypot(
        site.terrain.height_at(x + step, y) - site.terrain.height_at(x - step, y),
        site.terrain.height_at(x, y + step) - site.terrain.height_at(x, y - step),
    )
    patchy = smooth_noise(site.seed, COLOUR, x, y, 7.0)
    # A standard normal is less than 2.6 (green - 0.5) with a probability of about `green`, from
    # 0.2 to 0.8.
    material = np.where(patchy < 2.6 * (site.green - 0.5), LAWN, SOIL)
    material = np.where(rise / (2 * step) > 0.9, ROCK, material)
    if site.street_m > 0:
        edge = np.minimum(
            np.abs(_from_edge(x, site.block_m)), np.abs(_from_edge(y, site.block_m))
        )
        material = np.where(edge < site.street_m, ASPHALT, material)
    return np.asarray(material, dtype=np.intp)


def _from_edge(x: Float64, side: float) -> Float64:
    return np.asarray(x - side * np.rint(x / side))


def shadows(skin: MatchedSurface) -> Bool:
    """Return a mask of the nodes of a surface in the shadow of a node within `SHADOW_REACH_M`."""
    length = float(np.hypot(*SUN_STEP)) * PIXEL_M
    climb = length * np.tan(np.radians(SUN_ELEVATION_DEG))
    dark = np.zeros_like(skin.sharp, dtype=np.bool_)
    height, width = skin.sharp.shape
    for step in range(1, int(SHADOW_REACH_M / length) + 1):
        rows, columns = -SUN_STEP[0] * step, -SUN_STEP[1] * step
        if rows >= height or columns >= width:
            break
        sunward = skin.sharp[: height - rows, : width - columns]
        dark[rows:, columns:] |= sunward > skin.sharp[rows:, columns:] + step * climb + 0.2
    return dark


def colours(
    site: Site,
    x: Float64,
    y: Float64,
    label: UInt8,
    thing: Int64,
    facade: Bool,
    dark: Bool,
    rng: np.random.Generator,
) -> UInt16:
    """Return the colour of each point: uint16, shape (n, 3), 8-bit values times 256.

    Parameters
    ----------
    site : Site
    x, y : float64, shape (n,), metres
    label : uint8, shape (n,)
    thing : int64, shape (n,)
        `tiler.simulate.matched_surface.solid_number` of the solid at the point, or -1 if there is none.
    facade, dark : bool, shape (n,)
        Masks of the points on walls, and of the points in shadow.
    rng : numpy.random.Generator
    """
    material = ground_materials(site, x, y)
    for value, name in (
        (WATER, WATERS),
        (LOW_VEGETATION, PLANTS),
        (MEDIUM_VEGETATION, LEAVES),
        (HIGH_VEGETATION, LEAVES),
        (BRIDGE, CONCRETE),
        (BUILDING, CONCRETE),
    ):
        material = np.where(label == value, name, material)
    rgb = MATERIALS[np.where(facade, FACADE, material)]
    kind = node_normals(site.seed, COLOUR, thing, thing)
    pick = np.floor((kind + 4.0) * 97.0).astype(np.intp)
    roof = (label == BUILDING) & (thing >= 0) & ~facade
    rgb[roof] = ROOFS[pick[roof] % len(ROOFS)]
    paint = ~np.isin(label, (GROUND, WATER, BUILDING, BRIDGE)) & (thing >= 0)
    rgb[paint] = PAINTS[pick[paint] % len(PAINTS)]
    plants = np.isin(material, (LAWN, PLANTS, LEAVES)) & (thing < 0)
    # The colour of plants varies from green to straw, and the brightness of all surfaces
    # varies.
    dry = np.clip(0.25 + 0.25 * smooth_noise(site.seed, COLOUR, x, y, 4.0), 0.0, 0.8) * plants
    straw = np.array([150.0, 142.0, 96.0])
    rgb = rgb * (1.0 - dry[:, None]) + straw * dry[:, None]
    light = 1.0 + 0.1 * smooth_noise(site.seed, COLOUR, x, y, 1.3)
    light = light * (1.0 + np.where(plants, 0.16, 0.06) * rng.standard_normal(len(x)))
    rgb = rgb * np.clip(light, 0.4, 1.5)[:, None]
    rgb = np.where(dark[:, None], rgb * SHADE, rgb) + 4.0 * rng.standard_normal(rgb.shape)
    return (np.clip(np.rint(rgb), 1, 255) * 256).astype(np.uint16)
