"""Extent, levels, shores and profiles that a run finds in the simulated scenes of water, against the truth.

``python -m tests.benchmarks.water [--seeds 1 2] [--classes] [SCENE ...]`` prints a table.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import rasterio
import scipy
import shapely

from tests.scenes.water_scenes import UNKNOWN, WATER_KNOWN, WATER_SCENES, write_cloud
from tiler.config import RunConfig
from tiler.core.products import WATER
from tiler.pipeline import run
from tiler.simulate import Site, describe_scene
from tiler.simulate.files import ORIGIN

BORDER_M = 4
"""Pixels so near to the border of the survey are not counted."""
BEYOND_NOISE_M = 0.1


def measured(site: Site, out: Path) -> dict[str, Any]:
    """Figures of a finished run.

    Returns
    -------
    dict
        ``recall`` and ``precision`` of the area, ``level_rmse`` in metres where both are water, ``shore_rmse`` in
        metres, ``floating`` (share of the pixels beside water that lie below it), ``dug`` (share of the outermost
        pixels of water that lie on land above it), ``dug_far`` (the same, but only pixels farther than a pixel's
        diagonal from true water: nearer ones may be cut by an upright bank), ``dug_whole`` (the same, but only pixels
        without the true shore in them), ``void`` (share of the water, up to the border, without a height), ``rises``
        (metres that the lines of flow rise), ``bodies``.
    """
    with rasterio.open(out / "dtm.tif") as raster:
        heights, bounds = raster.read(1), raster.bounds
        rows, cols = np.mgrid[0 : raster.height, 0 : raster.width]
        size = raster.res[0]
    x = bounds.left + (cols + 0.5) * size - ORIGIN[0]
    y = bounds.top - (rows + 0.5) * size - ORIGIN[1]
    with rasterio.open(out / "mask.tif") as raster:
        found = raster.read(1) == WATER
    inner = (np.minimum(x, site.side_m - x) > BORDER_M) & (
        np.minimum(y, site.north_m - y) > BORDER_M
    )
    wet = site.terrain.wet_at(x, y)
    truth = site.terrain.height_at(x, y)
    both = found & wet & inner
    beside = (
        scipy.ndimage.binary_dilation(found, np.ones((3, 3)))
        & ~found
        & inner
        & (heights != -9999)
    )
    near = scipy.ndimage.distance_transform_edt(
        ~found, return_distances=False, return_indices=True
    )
    level = heights[tuple(near)]
    edge = found & ~scipy.ndimage.binary_erosion(found, np.ones((3, 3))) & inner
    dug = edge & ~wet & (truth > heights + 3 * BEYOND_NOISE_M)
    dug_whole = dug.copy()
    offsets = np.linspace(-size / 2, size / 2, 5)
    corners = [(x[dug] + east, y[dug] + north) for east in offsets for north in offsets]
    lowest = np.min([site.terrain.height_at(*at) for at in corners], axis=0)
    dug_whole[dug] = lowest > heights[dug] + 3 * BEYOND_NOISE_M
    from_water = (
        scipy.ndimage.distance_transform_edt(~wet) if wet.any() else np.full(wet.shape, np.inf)
    )
    return {
        "recall": _share(both, wet & inner),
        "precision": _share(both, found & inner),
        "level_rmse": float(np.sqrt(np.mean((heights - truth)[both] ** 2)))
        if both.any()
        else np.nan,
        "shore_rmse": _shore(wet, found, inner) * size,
        "floating": _share(beside & (heights < level - BEYOND_NOISE_M), beside),
        "void": _share(wet & (heights == -9999), wet),
        "dug": _share(dug, edge),
        "dug_far": _share(dug & (from_water > 1.5), edge),
        "dug_whole": _share(dug_whole, edge),
        **_profiles(out),
    }


def _share(part: np.ndarray, whole: np.ndarray) -> float:
    return float(part.sum() / whole.sum()) if whole.any() else np.nan


def _shore(wet: np.ndarray, found: np.ndarray, inner: np.ndarray) -> float:
    """Distance of the found shore from the true one in pixels, RMS; those farther than 20 pixels are not counted."""

    def edges(water: np.ndarray) -> np.ndarray:
        return water & ~scipy.ndimage.binary_erosion(water, border_value=1)

    if not edges(wet).any() or not found.any():
        return np.nan
    distance = scipy.ndimage.distance_transform_edt(~edges(wet))[edges(found) & inner]
    return float(np.sqrt(np.mean(distance[distance < 20] ** 2)))


def _profiles(out: Path) -> dict[str, Any]:
    """How much lines of flow rise, and how many bodies there are."""
    path = out / "water.gpkg"
    if not path.exists():
        return {"rises": 0.0, "bodies": 0}
    bodies = len(pyogrio.raw.read(path, layer="water")[2])
    rises = 0.0
    if "flow" in pyogrio.list_layers(path)[:, 0]:
        for line in shapely.from_wkb(pyogrio.raw.read(path, layer="flow")[2]):
            rises = max(
                rises, float(np.diff(shapely.get_coordinates(line, include_z=True)[:, 2]).max())
            )
    return {"rises": rises, "bodies": bodies}


def scored(
    name: str, seed: int, folder: Path, classes: bool = False, **changes: Any
) -> dict[str, Any]:
    """Simulate a scene, run the whole job on it, and measure; OUT is ``folder / "out"``."""
    spec = describe_scene(name, seed=seed)
    cloud = write_cloud(folder / "cloud.laz", spec, WATER_KNOWN if classes else UNKNOWN)
    values = {
        "workers": 1,
        "resolution": "1",
        "products": "dtm,mask",
        "in_process": True,
        "memory": "2GiB",
        **changes,
    }
    run([str(cloud)], folder / "out", RunConfig.from_mapping(values))
    return measured(spec.make_site(), folder / "out")


def main() -> None:
    """Print a table of the scenes."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="*", default=WATER_SCENES)
    parser.add_argument("--seeds", nargs="*", type=int, default=[1])
    parser.add_argument("--classes", action="store_true")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    for name in arguments.scenes:
        for seed in arguments.seeds:
            with tempfile.TemporaryDirectory() as scratch:
                folder = arguments.out / f"{name}-{seed}" if arguments.out else Path(scratch)
                folder.mkdir(parents=True, exist_ok=True)
                figures = scored(name, seed, folder, arguments.classes)
            print(
                f"{name:16}",
                seed,
                *(f"{key} {value:.3f}" for key, value in figures.items()),
                flush=True,
            )


if __name__ == "__main__":
    main()
