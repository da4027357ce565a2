"""Colours of a photogrammetric cloud: materials, their variation, and shadows."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tiler.core.classes import GROUND, WATER
from tiler.simulate.matched_surface import PIXEL_M, MatchedSurface
from tiler.simulate.objects import (
    BRIDGE,
    BUILDING,
    HIGH_VEGETATION,
    LOW_VEGETATION,
    MEDIUM_VEGETATION,
)
from tiler.simulate.randomness import COLOUR, node_normals, smooth_noise
from tiler.simulate.site import Site

Floats = npt.NDArray[np.float64]

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


def ground_materials(site: Site, x: Floats, y: Floats) -> npt.NDArray[np.intp]:
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


def _from_edge(x: Floats, side: float) -> Floats:
    return np.asarray(x - side * np.rint(x / side))


def shadows(skin: MatchedSurface) -> npt.NDArray[np.bool_]:
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
    x: Floats,
    y: Floats,
    label: npt.NDArray[np.uint8],
    thing: npt.NDArray[np.int64],
    facade: npt.NDArray[np.bool_],
    dark: npt.NDArray[np.bool_],
    rng: np.random.Generator,
) -> npt.NDArray[np.uint16]:
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
