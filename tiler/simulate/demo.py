"""The simulated city of the demo: four input clouds, their true classes, and the true terrain."""

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
    """Files and truth that `demo_city` wrote.

    Attributes
    ----------
    paths, truth_paths : tuple of Path
        Four clouds (classes 0 and 1), and the same rows with the true classes.
    dtm_path : Path
        The true terrain, float32 GeoTIFF.
    terrain : Terrain
        The formula behind it, in metres from `tiler.simulate.cloud.ORIGIN`.
    points : int
        Number of points in all four clouds.
    """

    paths: tuple[Path, ...]
    truth_paths: tuple[Path, ...]
    dtm_path: Path
    terrain: Terrain
    points: int


def demo_files(folder: Path) -> list[Path]:
    """The files that `demo_city` writes: clouds, clouds with true classes, true terrain."""
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
    """Write the city of a seed into ``folder``: ``city_{sw,se,nw,ne}.laz``, ``truth/`` and ``truth/dtm.tif``.

    Parameters
    ----------
    folder : path
        Created if necessary; files of these names are replaced.
    seed : int
        The same seed gives the same bytes.
    side_m : float
        Side of the city, metres: at least 100.
    sensor : AlsSensor, optional
    dtm_m : float
        Pixel size of the true terrain, metres.
    """
    folder = Path(folder)
    (folder / "truth").mkdir(parents=True, exist_ok=True)
    site, sensor = city(seed, side_m), sensor or AlsSensor()
    files = demo_files(folder)
    paths, truth_paths, dtm_path = tuple(files[:4]), tuple(files[4:8]), files[8]
    with ExitStack() as open_files:
        clouds, truths = (
            [open_files.enter_context(CloudWriter(path)) for path in group] for group in (paths, truth_paths)
        )
        # The rim would add half of the work for the last metre or two of the city.
        for index in patches(sensor, side_m, rim=False):
            points = survey_patch(site, sensor, *index)
            part = (points.xyz[:, 0] >= side_m / 2) + 2 * (points.xyz[:, 1] >= side_m / 2)
            for number in range(len(PARTS)):
                inside = points.take(part == number)
                clouds[number].write(inside, np.where(inside.label == UNCLASSIFIED, 0, 1).astype(np.uint8))
                truths[number].write(inside)
    write_dtm(dtm_path, site, dtm_m)
    return DemoScene(paths, truth_paths, dtm_path, site.terrain, sum(cloud.points for cloud in clouds))
