"""Terrain that other programs make of surface models, against the truth of the semi-real matched clouds, as Markdown.

``python -m tests.benchmarks.surfaces [--scenes rows,bluff]``

These programs read a raster: the highest point in each pixel of 0.5 m, with the nearest height in empty pixels. Each
has its defaults. What `tiler run` makes of the same clouds: ``tests/benchmarks/matched_runs.py``.
"""

from __future__ import annotations

import argparse
import importlib
import logging
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import mean

import laspy
import numpy as np
import rasterio
from scipy import ndimage

from tests.benchmarks.matched_runs import difference
from tests.benchmarks.peers import installed, silent
from tests.benchmarks.scorecard import DATA
from tests.benchmarks.scorecard_scenes import SEMI_REAL_SCENES
from tests.benchmarks.scorecard_text import table

NODATA = -32768.0
UTM_ZONE = "EPSG:32631"
"""CRS of the rasters, as dsm2dtm needs one in metres."""

Surfaces = Callable[[Path, Path], Path]
"""Function of a surface model and of a folder that returns the path of the terrain."""


def dsm2dtm(surface: Path, folder: Path) -> Path:
    """dsm2dtm, with its defaults."""
    target = folder / "dsm2dtm.tif"
    importlib.import_module("dsm2dtm").generate_dtm_file(surface, target, workers=1)
    return target


def bulldozer(surface: Path, folder: Path) -> Path:
    """Bulldozer of CNES and CS, with its defaults."""
    pipeline = importlib.import_module("bulldozer.pipeline.bulldozer_pipeline")
    target = folder / "bulldozer"
    pipeline.dsm_to_dtm(dsm_path=str(surface), output_dir=str(target), nb_max_workers=1)
    return next(target.rglob("*dtm*.tif"))


PROGRAMS: Mapping[str, tuple[str, Surfaces]] = {
    "dsm2dtm": ("dsm2dtm", dsm2dtm),
    "bulldozer-dtm": ("bulldozer", bulldozer),
}
"""Module and function by the name of the package."""


def surface_of(cloud: Path, truth: Path, target: Path) -> Path:
    """Write the highest point in each pixel of the true terrain, the nearest height where there is none."""
    with rasterio.open(truth) as raster:
        shape, transform = raster.shape, raster.transform
    xyz = np.asarray(laspy.read(cloud).xyz)
    columns = np.floor((xyz[:, 0] - transform.c) / transform.a).astype(np.intp)
    rows = np.floor((xyz[:, 1] - transform.f) / transform.e).astype(np.intp)
    inside = (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
    heights = np.full(shape, -np.inf)
    np.maximum.at(heights, (rows[inside], columns[inside]), xyz[inside, 2])
    nearest = ndimage.distance_transform_edt(
        np.isinf(heights), return_distances=False, return_indices=True
    )
    values = heights[tuple(nearest)].astype(np.float32)
    with rasterio.open(
        target, "w", driver="GTiff", height=shape[0], width=shape[1], count=1, dtype="float32", crs=UTM_ZONE,
        nodata=NODATA, transform=transform,
    ) as raster:  # fmt: skip
        raster.write(values, 1)
    return target


def rmse_m(make: Surfaces, name: str) -> float:
    """Root mean square error of a program's terrain on a scene, in metres."""
    folder = DATA / "dim/semireal"
    truth = folder / f"{name}_dtm.tif"
    with tempfile.TemporaryDirectory() as scratch, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Their own use of libraries is deprecated.
        surface = surface_of(folder / f"{name}.laz", truth, Path(scratch, "surface.tif"))
        with silent():
            terrain = make(surface, Path(scratch))
        return float(np.sqrt(np.nanmean(difference(terrain, truth) ** 2)))


def rows_of(scenes: Sequence[str], programs: Mapping[str, Surfaces]) -> Iterator[list[str]]:
    """Yield a row for each program: the mean error, and that of each scene."""
    for name, make in programs.items():
        errors = [rmse_m(make, scene) for scene in scenes]
        yield [name, *(f"{error:.2f} m" for error in (mean(errors), *errors))]


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scenes", help="only these, with commas")
    given = parser.parse_args(arguments)
    known = [n for n in SEMI_REAL_SCENES if (DATA / f"dim/semireal/{n}.laz").is_file()]
    scenes = [n for n in known if given.scenes is None or n in given.scenes.split(",")]
    if not scenes:
        sys.exit(f"no scene: there is nothing for any of these in {DATA}")
    logging.disable(logging.CRITICAL)
    programs = {n: make for n, (module, make) in PROGRAMS.items() if installed(module)}
    print(table(["program", "mean", *scenes], list(rows_of(scenes, programs))))
    for name in PROGRAMS.keys() - programs.keys():
        print(f"- {name} is left out: not installed: pip install {name}")


if __name__ == "__main__":
    main()
