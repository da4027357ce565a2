"""Matched clouds made of classified laser scans, as a simulated matcher sees their surfaces; the truth is complete.

The highest returns make a surface whose crowns are closed and whose edges are rounded. It is
sampled at random, with holes, points on facades, noise of each point's own and noise that
neighbours share (more in shadow, on plants and where nothing has texture), and blunders below
it, alone and in clumps. A point's class is that of the surface before noise: what lies less
than 0.2 m above the terrain of the scan (the TIN of its ground) is ground.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.spatial import cKDTree

from tests.benchmarks.kept import digest_of_modules
from tests.benchmarks.scorecard_scenes import BenchScene, Cloud, bilinear, read_clouds

GROUP = "image matching made of laser scans"
GROUND, LOW_PLANTS, SHRUBS, TREES, BUILDING, BLUNDER, WATER, BRIDGE = 2, 3, 4, 5, 6, 7, 9, 17
LEFT_OUT = (7, 18, 64, 65, 67)
PIXEL_M = 0.25
PIXELS_OF_TRUTH = 2
"""Pixels of the surface on a side of one of the true terrain."""
SIGMA_M = 0.066
GROUND_M = 0.2
BOX_M = 220.0

Array = np.ndarray


@dataclass(frozen=True)
class Site:
    """A laser scan and how it is seen.

    Attributes
    ----------
    files : str
        Pattern in the folder of real data.
    cell_m : float
        The highest return of each such cell is the surface.
    seed : int
    around : int or None
        A square of `BOX_M` around the middle of the points of this class, instead of all.
    classified : bool
        Whether there is more than ground and the rest: else smooth surfaces are roofs, rough ones plants.
    """

    files: str
    cell_m: float
    seed: int
    around: int | None = None
    classified: bool = True


SITES = {
    "town": Site("ign/tiles50m/*.laz", 0.4, 11),
    "buildings, shrubs": Site("ign/bat.laz", 0.35, 12),
    "field": Site("ign/crop_3.laz", 0.5, 13),
    "bridge": Site("ign/test_semis_2023_0292_6833.laz", 1.2, 14, around=BRIDGE),
    "old town": Site("ign/test_semis_2023_0292_6833.laz", 1.2, 15, around=BUILDING),
    "terraced slope": Site("isprs/samp11-utm.laz", 1.0, 21, classified=False),
    "city": Site("isprs/samp12-utm.laz", 1.0, 22, classified=False),
    "railway cutting": Site("isprs/samp22-utm.laz", 1.0, 23, classified=False),
    "ramp": Site("isprs/samp24-utm.laz", 1.0, 26, classified=False),
    "blocks": Site("isprs/samp31-utm.laz", 1.0, 24, classified=False),
    "station": Site("isprs/samp42-utm.laz", 1.0, 25, classified=False),
}


def scan_scenes(data: Path) -> Iterator[BenchScene]:
    """The scenes whose scans are in a folder of real data."""
    recipe = digest_of_modules(__name__)
    for name, site in SITES.items():
        files = tuple(sorted(data.glob(site.files)))
        if files:
            yield BenchScene(
                name,
                GROUP,
                GROUP,
                partial(load, site, files),
                recipe=f"{site} {recipe}",
                files=files,
            )


def load(site: Site, files: tuple[Path, ...]) -> Cloud:
    """The matched cloud of a site."""
    scan = read_clouds(files)
    kept = ~np.isin(scan.classification, LEFT_OUT)
    return matched(scan.xyz[kept], scan.classification[kept], site)


def matched(xyz: Array, classes: Array, site: Site) -> Cloud:
    """The matched cloud of the points of a scan."""
    rng = np.random.default_rng(site.seed)
    if site.around is not None:
        middle = np.median(xyz[classes == site.around, :2], axis=0)
        inside = (abs(xyz[:, :2] - middle) <= BOX_M / 2).all(axis=1)
        xyz, classes = xyz[inside], classes[inside]
    xyz = xyz - np.floor(xyz.min(axis=0))
    terrain, surface, seen, void = _surface(xyz, classes, site)
    surface = ndimage.gaussian_filter(surface, rng.uniform(0.2, 0.3) / PIXEL_M)
    seen = _true_classes(seen, surface - terrain)
    x, y, z, found = _sampled(surface, terrain, seen, void, rng)
    x, y, z, found = _with_blunders(x, y, z, found, terrain, rng)
    rows, columns = (n // PIXELS_OF_TRUTH * PIXELS_OF_TRUTH for n in terrain.shape)
    blocks = terrain[:rows, :columns].reshape(
        rows // PIXELS_OF_TRUTH, PIXELS_OF_TRUTH, -1, PIXELS_OF_TRUTH
    )
    pixel_m, heights = PIXEL_M * PIXELS_OF_TRUTH, blocks.mean(axis=(1, 3))[::-1]
    return Cloud(
        np.stack([x, y, z], axis=1), found.astype(np.uint8), truth=partial(bilinear, heights, pixel_m),
        side_m=max(heights.shape) * pixel_m, pixel_m=pixel_m,
    )  # fmt: skip


def _surface(xyz: Array, classes: Array, site: Site) -> tuple[Array, Array, Array, Array]:
    """Terrain, the highest returns with closed crowns, their classes, and where there is no return near."""
    cell = np.floor(xyz[:, :2] / site.cell_m).astype(np.int64) @ (2**20, 1)
    order = np.lexsort((-xyz[:, 2], cell))
    top = order[np.flatnonzero(np.diff(cell[order], prepend=-1))]
    tops, of = xyz[top], classes[top]
    tree = cKDTree(tops[:, :2])
    if not site.classified:
        of = _split(tops, of, tree)
    columns, rows = (int(side / PIXEL_M) + 1 for side in xyz[:, :2].max(axis=0))
    x, y = np.meshgrid((np.arange(columns) + 0.5) * PIXEL_M, (np.arange(rows) + 0.5) * PIXEL_M)
    distance, nearest = map(np.asarray, tree.query(np.stack([x.ravel(), y.ravel()], axis=1)))
    seen = of[nearest].reshape(x.shape)
    terrain = _tin(xyz[classes == GROUND], x, y)
    stands = ~np.isin(seen, (GROUND, WATER))
    surface = np.where(
        stands, np.maximum(_tin(tops[~np.isin(of, (GROUND, WATER))], x, y), terrain), terrain
    )
    disk = np.hypot(*np.mgrid[-1.2:1.3:PIXEL_M, -1.2:1.3:PIXEL_M]) <= 1.2
    crowns = stands & (seen != BUILDING) & (surface > terrain + 1.5)
    closed = ndimage.grey_closing(np.where(crowns, surface, terrain), footprint=disk)
    gaps = ndimage.binary_closing(crowns, disk) & (closed > surface + 0.5) & (seen != BUILDING)
    void = (distance.reshape(x.shape) > (3.0 if site.cell_m < 1.0 else 5.0)) | (seen == WATER)
    return (
        terrain,
        np.where(gaps, closed, surface),
        np.where(gaps & (seen == GROUND), TREES, seen),
        void,
    )


def _tin(points: Array, x: Array, y: Array) -> Array:
    """Linear interpolation, beyond the points' hull the nearest height."""
    found: Array = LinearNDInterpolator(points[:, :2], points[:, 2])(x, y)
    beyond = np.isnan(found)
    found[beyond] = NearestNDInterpolator(points[:, :2], points[:, 2])(x[beyond], y[beyond])
    return found


def _split(tops: Array, classes: Array, tree: cKDTree) -> Array:
    """Roofs and plants among what is not ground, by how flat the eight nearest returns and their neighbours are."""
    near = tree.query(tops[:, :2], 8)[1]
    spread = tops[near] - tops[near].mean(axis=1, keepdims=True)
    flat = np.linalg.svd(spread, compute_uv=False)[:, 2] < 0.2 * np.sqrt(8)
    return np.where(
        classes == GROUND, GROUND, np.where(flat[near].mean(axis=1) > 0.5, BUILDING, TREES)
    )


def _true_classes(seen: Array, above: Array) -> Array:
    """Classes after the rounding of edges: what it raised belongs to the object beside, plants go by height."""
    fixed = np.isin(seen, (WATER, BRIDGE))
    found = np.where((above < GROUND_M) & ~fixed, GROUND, seen)
    raised = (found == GROUND) & (above >= GROUND_M)
    beside = ndimage.distance_transform_edt(
        raised | (found == GROUND), return_distances=False, return_indices=True
    )
    found[raised] = found[tuple(beside)][raised]
    plants = np.isin(found, (LOW_PLANTS, SHRUBS, TREES))
    heights = np.where(above < 0.5, LOW_PLANTS, np.where(above < 1.5, SHRUBS, TREES))
    return np.where(plants, heights, found)


def _field(shape: tuple[int, ...], length_m: float, rng: np.random.Generator) -> Array:
    """A Gaussian field of variance 1, of which 30 % has four times the length."""
    found = np.zeros(shape)
    for share, length in ((0.7, length_m), (0.3, 4 * length_m)):
        one = ndimage.gaussian_filter(
            rng.standard_normal(shape), 0.8 * length / PIXEL_M, mode="wrap"
        )
        found += np.sqrt(share) * one / one.std()
    return found


def _shadow(surface: Array, elevation: float, azimuth: float) -> Array:
    """Where something nearer than 30 m stands before the sun (degrees)."""
    east, north, rise = (
        np.sin(np.deg2rad(azimuth)),
        np.cos(np.deg2rad(azimuth)),
        np.tan(np.deg2rad(elevation)),
    )
    dark = np.zeros(surface.shape, bool)
    for away in np.arange(0.75, 30.0, 0.75):
        offset = (-north * away / PIXEL_M, -east * away / PIXEL_M)
        dark |= (
            ndimage.shift(surface, offset, order=0, mode="nearest") - away * rise
            > surface + 0.2
        )
    return dark


def _sampled(
    surface: Array, terrain: Array, seen: Array, void: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array, Array]:
    """Points on the surface and on facades, with noise, and their classes."""
    density, own, shared_m = rng.uniform(30, 40), rng.uniform(0.4, 0.6), rng.uniform(0.7, 1.2)
    dark = _shadow(surface, rng.uniform(35, 50), rng.uniform(90, 270))
    plants = np.isin(seen, (LOW_PLANTS, SHRUBS, TREES))
    bare = (_field(surface.shape, 3.0, rng) > 1.28) & ~plants
    noise = SIGMA_M * np.minimum(
        np.where(dark | plants, 2.0, 1.0) * np.where(bare, 2.2, 1.0), 3.0
    )
    shared = _field(surface.shape, shared_m, rng)
    hidden = _field(surface.shape, 2.5, rng) + 0.8 * dark
    void = void | (hidden > np.quantile(hidden, 1.0 - rng.uniform(0.02, 0.05)))
    rows, columns = (n * PIXEL_M for n in surface.shape)
    n = round(rows * columns * density)
    x, y = rng.uniform(0, columns, n), rng.uniform(0, rows, n)
    i, j = (y / PIXEL_M).astype(int), (x / PIXEL_M).astype(int)
    x, y, i, j = (v[~void[i, j]] for v in (x, y, i, j))
    z, found = _at(surface, x, y), seen[i, j]
    low, high = ndimage.minimum_filter(surface, 5), ndimage.maximum_filter(surface, 5)
    walls = (high - low > 2.0) & ndimage.binary_dilation(seen == BUILDING, iterations=3)
    wi, wj = np.nonzero(walls & (_field(surface.shape, 6.0, rng) < 0.67))
    many = rng.poisson((high - low)[wi, wj] * PIXEL_M * density * 0.1)
    wi, wj = np.repeat(wi, many), np.repeat(wj, many)
    wz = low[wi, wj] + (high - low)[wi, wj] * rng.random(wi.size)
    x, y = (np.append(v, (w + rng.random(w.size)) * PIXEL_M) for v, w in ((x, wj), (y, wi)))
    found = np.append(found, np.where(wz - terrain[wi, wj] < GROUND_M, GROUND, BUILDING))
    i, j = np.append(i, wi), np.append(j, wj)
    alone = rng.standard_t(4, x.size) / np.sqrt(2.0)
    scatter = np.sqrt(own) * alone + np.sqrt(1.0 - own) * _at(shared, x, y)
    return x, y, np.append(z, wz) + noise[i, j] * scatter, found


def _with_blunders(
    x: Array, y: Array, z: Array, found: Array, terrain: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array, Array]:
    """One point of 2000 lies 0.8 to 15 m lower, and one clump of 5 to 30 in 900 m2 lies below the ground."""
    low = rng.random(x.size) < 0.0005
    z = z - np.where(low, np.exp(rng.uniform(np.log(0.8), np.log(15.0), x.size)), 0.0)
    rows, columns = (n * PIXEL_M for n in terrain.shape)
    clumps = int(rows * columns / 900.0) + 1
    sizes = rng.integers(5, 30, clumps)
    wide, deep = (
        np.repeat(rng.uniform(*span, clumps), sizes) for span in ((0.15, 0.5), (0.5, 4.0))
    )
    cx, cy = (
        np.repeat(rng.uniform(0, side, clumps), sizes) + wide * rng.uniform(-1, 1, sizes.sum())
        for side in (columns, rows)
    )
    inside = (cx > 0) & (cx < columns) & (cy > 0) & (cy < rows)
    cx, cy, deep = cx[inside], cy[inside], deep[inside]
    cz = _at(terrain, cx, cy) - deep + 0.08 * rng.standard_normal(cx.size)
    found = np.append(np.where(low, BLUNDER, found), np.full(cx.size, BLUNDER))
    return np.append(x, cx), np.append(y, cy), np.append(z, cz), found


def _at(raster: Array, x: Array, y: Array) -> Array:
    """Heights between the centres of pixels."""
    found: Array = ndimage.map_coordinates(
        raster, [y / PIXEL_M - 0.5, x / PIXEL_M - 0.5], order=1, mode="nearest"
    )
    return found
