"""What `tiler run` makes of the semi-real matched clouds: its terrain against the true one, and what is left in it.

``python tests/benchmarks/matched_runs.py OUT [--scenes rows,bluff] [--preset dim]``

Each scene of ``../shared/data/dim/semireal`` is run as a user would, at 0.5 m, with its classes
hidden, with the default settings or those of a preset. Markdown goes to the standard output; a
folder of a run stays in OUT and is resumed.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean

import numpy as np
import rasterio
from rasterio.windows import from_bounds
from scipy import ndimage

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.benchmarks.scorecard import DATA
from tests.benchmarks.scorecard_scenes import SEMI_REAL_SCENES, Cloud, read_with_dtm
from tests.benchmarks.scorecard_text import table

PIXEL_M = 0.5
HIGH_M, AREA_M2 = 1.0, 4.0
"""What rises so far above the true terrain over such an area is an object that was left."""

WHAT = {
    1: "car, fence",
    2: "ground",
    3: "low plants",
    4: "shrubs",
    5: "trees",
    6: "building",
    17: "bridge",
}


@dataclass(frozen=True)
class Left:
    """An object that stands in a DTM: metres from the scene's south-west corner, metres, square metres, class."""

    x: float
    y: float
    area_m2: float
    height_m: float
    what: str

    def __str__(self) -> str:
        return f"{self.what} at {self.x:.0f}, {self.y:.0f} ({self.area_m2:.0f} m2, up to {self.height_m:.1f} m)"


@dataclass(frozen=True)
class Terrain:
    """A DTM less the true one, where both exist; the share of the true pixels that it has; what is left in it."""

    rmse_m: float
    bias_m: float
    share: float
    left: tuple[Left, ...]


def run(cloud: Path, out: Path, preset: str | None) -> Path:
    """The DTM of a run; raises where it fails."""
    command = [
        sys.executable,
        "-c",
        "from cli.main import main; main()",
        "run",
        str(cloud),
        "-o",
        str(out),
    ]
    command += ["--resolution", str(PIXEL_M), "--keep-classes", "none", "--workers", "1"]
    command += ["--preset", preset] if preset else []
    subprocess.run(
        command, check=True, cwd=Path(__file__).resolve().parents[2], stdout=subprocess.DEVNULL
    )
    return out / "dtm.tif"


def difference(dtm: Path, truth: Path) -> np.ndarray:
    """Heights less the true ones on the pixels of the latter; NaN where one is missing."""
    with rasterio.open(truth) as raster:
        true = raster.read(1, masked=True).astype(np.float64).filled(np.nan)
        bounds = raster.bounds
    with rasterio.open(dtm) as raster:
        window = from_bounds(*bounds, transform=raster.transform)
        own = (
            raster.read(1, window=window, boundless=True, masked=True)
            .astype(np.float64)
            .filled(np.nan)
        )
    return np.asarray(own - true)


def objects_left(off: np.ndarray, cloud: Cloud) -> Iterator[Left]:
    """Connected pixels (8 neighbours) that rise above the true terrain, the largest first."""
    numbers, count = ndimage.label(np.nan_to_num(off) > HIGH_M, np.ones((3, 3)))
    areas = PIXEL_M**2 * np.bincount(numbers.ravel(), minlength=count + 1)
    x, y = cloud.xyz[:, :2].T
    row = np.clip((off.shape[0] - y / PIXEL_M).astype(np.intp), 0, off.shape[0] - 1)
    column = np.clip((x / PIXEL_M).astype(np.intp), 0, off.shape[1] - 1)
    of_point = numbers[row, column]
    for number in np.argsort(-areas[1:]) + 1:
        if areas[number] <= AREA_M2:
            return
        rows, columns = np.nonzero(numbers == number)
        classes = np.bincount(cloud.classification[of_point == number], minlength=18)
        what = (
            WHAT.get(int(classes.argmax()), "nothing seen") if classes.any() else "nothing seen"
        )
        middle = (
            float(np.mean(columns) + 0.5) * PIXEL_M,
            float(off.shape[0] - np.mean(rows) - 0.5) * PIXEL_M,
        )
        yield Left(*middle, float(areas[number]), float(np.nanmax(off[rows, columns])), what)


def measured(name: str, out: Path, preset: str | None) -> Terrain:
    """Run a scene and compare."""
    folder = DATA / "dim/semireal"
    cloud, truth = folder / f"{name}.laz", folder / f"{name}_dtm.tif"
    off = difference(run(cloud, out / f"{name}_{preset or 'default'}", preset), truth)
    with rasterio.open(truth) as raster:
        known = np.sum(~raster.read(1, masked=True).mask)
    left = tuple(objects_left(off, read_with_dtm(cloud, truth)))
    rmse = float(np.sqrt(np.nanmean(off**2)))
    return Terrain(rmse, float(np.nanmean(off)), float(np.sum(~np.isnan(off)) / known), left)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run, compare, print."""
    parser = argparse.ArgumentParser(
        description="Compare the terrain of runs with the true one."
    )
    parser.add_argument("out", type=Path, help="folder for the runs")
    parser.add_argument("--scenes", help="only these, with commas")
    parser.add_argument("--preset", help="settings of a preset instead of the default ones")
    given = parser.parse_args(arguments)
    names = given.scenes.split(",") if given.scenes else SEMI_REAL_SCENES
    found = {name: measured(name, given.out, given.preset) for name in names}
    rows = [
        [name, f"{t.rmse_m:.3f}", f"{t.bias_m:+.3f}", f"{100 * t.share:.1f}", str(len(t.left))]
        for name, t in found.items()
    ]
    rows.append(["mean", f"{mean(t.rmse_m for t in found.values()):.3f}", "", "", ""])
    print(table(["scene", "RMSE m", "bias m", "pixels %", f"left above {HIGH_M:g} m"], rows))
    for name, terrain in found.items():
        print(f"- {name}: {'; '.join(map(str, terrain.left)) or 'nothing'}")


if __name__ == "__main__":
    main()
