"""Simulated city of the demo: four input clouds with their reference classes and terrain."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiler.core.classes import UNCLASSIFIED
from tiler.simulate.als import AlsSensor
from tiler.simulate.cloud import CloudWriter, write_dtm
from tiler.simulate.points import patches, survey_patch
from tiler.simulate.sites import city
from tiler.simulate.terrain import Terrain

PARTS = ("sw", "se", "nw", "ne")


@dataclass(frozen=True)
class DemoScene:
    """Files and terrain that `demo_city` wrote.

    Attributes
    ----------
    paths, truth_paths : tuple of Path
        Four clouds with classes 0 and 1, and the same points with the reference classes.
    dtm_path : Path
        GeoTIFF of the reference terrain, float32.
    terrain : Terrain
        Formula of the terrain, in metres from `tiler.simulate.cloud.ORIGIN`.
    points : int
        Number of points in all four clouds.
    """

    paths: tuple[Path, ...]
    truth_paths: tuple[Path, ...]
    dtm_path: Path
    terrain: Terrain
    points: int


def demo_files(folder: Path) -> list[Path]:
    """List the files of `demo_city`: clouds, clouds with reference classes, and terrain."""
    names = [f"city_{name}.laz" for name in PARTS]
    truth = folder / "truth"
    return [*(folder / n for n in names), *(truth / n for n in names), truth / "dtm.tif"]


def demo_city(
    folder: Path | str,
    seed: int = 1,
    side_m: float = 600.0,
    sensor: AlsSensor | None = None,
    dtm_m: float = 1.0,
) -> DemoScene:
    """Write the city of a seed into a folder.

    The files are ``city_{sw,se,nw,ne}.laz``, clouds of the same names in ``truth/``, and
    ``truth/dtm.tif``.

    Parameters
    ----------
    folder : path
        Folder to write to. It is created if necessary, and files of these names are replaced.
    seed : int
        The same seed gives the same bytes.
    side_m : float
        Side of the city in metres, at least 100.
    sensor : AlsSensor, optional
    dtm_m : float
        Pixel size of the reference terrain, metres.
    """
    folder = Path(folder)
    (folder / "truth").mkdir(parents=True, exist_ok=True)
    site, sensor = city(seed, side_m), sensor or AlsSensor()
    files = demo_files(folder)
    paths, truth_paths, dtm_path = tuple(files[:4]), tuple(files[4:8]), files[8]
    with ExitStack() as open_files:
        clouds, truths = (
            [open_files.enter_context(CloudWriter(path)) for path in group]
            for group in (paths, truth_paths)
        )
        # Patches outside the city would cost much time and only complete its outermost metre or
        # two.
        for index in patches(sensor, side_m, rim=False):
            points = survey_patch(site, sensor, *index)
            part = (points.xyz[:, 0] >= side_m / 2) + 2 * (points.xyz[:, 1] >= side_m / 2)
            for number in range(len(PARTS)):
                inside = points.take(part == number)
                clouds[number].write(
                    inside, np.where(inside.label == UNCLASSIFIED, 0, 1).astype(np.uint8)
                )
                truths[number].write(inside)
    write_dtm(dtm_path, site, dtm_m)
    return DemoScene(
        paths, truth_paths, dtm_path, site.terrain, sum(cloud.points for cloud in clouds)
    )
