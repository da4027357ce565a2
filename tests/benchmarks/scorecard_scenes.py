"""Scenes of the scorecard: clouds in metres with a true class for each point, real ones and simulated ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from tests.benchmarks.kept import digest, digest_of_file, digest_of_modules

VIRTUAL = 66
"""A producer's points that nobody measured: they are no part of a scene."""

ISPRS_SAMPLES = "ISPRS samples"
OTHER_REAL = "other real clouds"
SEMI_REAL = "semi-real image matching"
"""Surfaces of real sites, made of classified laser scans, as a simulated matcher sees them:
their truth is complete."""

RAW = "simulated als raw"
"""Scenes with the low points that producers remove."""

SIMULATED = {"als": "simulated laser scanning", "dim": "simulated image matching"}

SEMI_REAL_SCENES = ("rows", "garden", "industry", "houses", "suburb", "bluff", "forest")
ISPRS = ("11", "12", "22", "24", "31", "42", "51", "53")


@dataclass(frozen=True)
class Cloud:
    """What a filter may see, and the truth.

    Attributes
    ----------
    xyz : float64 [n, 3]
        Metres.
    classification : uint8 [n]
        True classes, ASPRS.
    rgb : uint16 [n, 3] or None
    returns : uint8 [n, 2] or None
        Return number and number of returns.
    truth : callable or None
        True height of the ground at x, y, metres, NaN where it is unknown; for scenes from (0, 0) to (side_m, side_m).
    side_m : float
    pixel_m : float
        Side of the pixels at which the terrain is compared with the truth.
    """

    xyz: np.ndarray
    classification: np.ndarray
    rgb: np.ndarray | None = None
    returns: np.ndarray | None = None
    truth: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    side_m: float = 0.0
    pixel_m: float = 1.0


@dataclass(frozen=True)
class BenchScene:
    """A scene by name; `load` reads or makes it.

    Scenes of a family are averaged, those of a group stand in one table. What it is made of,
    files and a recipe, tells whether it is the same as in an earlier run.
    """

    name: str
    family: str
    group: str
    load: Callable[[], Cloud]
    with_truth: bool = True
    recipe: str = ""
    files: tuple[Path, ...] = ()

    def key(self) -> str:
        """A key of its points and its truth."""
        return digest(self.name, self.recipe, *map(digest_of_file, self.files))


def read_clouds(paths: Sequence[Path]) -> Cloud:
    """The points of LAZ files as one cloud, without those that are virtual."""
    import laspy

    parts = [laspy.read(path) for path in paths]
    xyz = np.concatenate([np.asarray(part.xyz) for part in parts])
    classes = np.concatenate([np.asarray(part.classification, np.uint8) for part in parts])
    returns = np.concatenate(
        [
            np.stack((np.asarray(p.return_number), np.asarray(p.number_of_returns)), axis=1)
            for p in parts
        ]
    ).astype(np.uint8)
    rgb = None
    if all("red" in part.point_format.dimension_names for part in parts):
        rgb = np.concatenate(
            [
                np.stack([np.asarray(p[c]) for c in ("red", "green", "blue")], axis=1)
                for p in parts
            ]
        )
    measured = classes != VIRTUAL
    return Cloud(
        xyz[measured],
        classes[measured],
        rgb[measured] if rgb is not None and rgb.any() else None,
        returns[measured] if returns.any() else None,
    )


def real_scenes(data: Path) -> Iterator[BenchScene]:
    """The labelled clouds of a folder of real data; nothing of what is not there."""
    found = [(ISPRS_SAMPLES, f"samp{n}", [data / f"isprs/samp{n}-utm.laz"]) for n in ISPRS]
    found += [
        ("other laser scanning", "AHN3 row houses", [data / "ahn3/ahn3_cropped_2.laz"]),
        (
            "other laser scanning",
            "IGN six tiles",
            sorted((data / "ign/tiles50m").glob("*.laz")),
        ),
        ("other laser scanning", "IGN buildings", [data / "ign/bat.laz"]),
        ("other laser scanning", "IGN crop 1", [data / "ign/crop_1.laz"]),
        ("other laser scanning", "IGN crop 3", [data / "ign/crop_3.laz"]),
        (
            "other laser scanning",
            "IGN town, thinned",
            [data / "ign/test_semis_2023_0292_6833.laz"],
        ),
        ("image matching", "Brighton park", [data / "dim/brighton_east.laz"]),
    ]
    for family, name, paths in found:
        if paths and all(path.is_file() for path in paths):
            group = family if family == ISPRS_SAMPLES else OTHER_REAL
            yield BenchScene(
                name, family, group, partial(read_clouds, paths), False, files=tuple(paths)
            )


def semi_real_scenes(data: Path) -> Iterator[BenchScene]:
    """The semi-real matched clouds of a folder of real data; nothing of what is not there."""
    for name in SEMI_REAL_SCENES:
        cloud, dtm = data / f"dim/semireal/{name}.laz", data / f"dim/semireal/{name}_dtm.tif"
        if cloud.is_file() and dtm.is_file():
            load = partial(read_with_dtm, cloud, dtm)
            yield BenchScene(name, SEMI_REAL, SEMI_REAL, load, files=(cloud, dtm))


def read_with_dtm(cloud: Path, dtm: Path) -> Cloud:
    """A cloud and its true terrain; (0, 0) is the south-west corner of the latter, which lies at whole metres."""
    import rasterio

    with rasterio.open(dtm) as raster:
        heights = raster.read(1, masked=True).astype(np.float64).filled(np.nan)
        bounds, (pixel_m, _) = raster.bounds, raster.res
    found = read_clouds([cloud])
    truth = partial(bilinear, heights, pixel_m)
    side_m = max(bounds.right - bounds.left, bounds.top - bounds.bottom)
    xyz = found.xyz - (bounds.left, bounds.bottom, 0.0)
    return replace(found, xyz=xyz, truth=truth, side_m=side_m, pixel_m=pixel_m)


def thinned(scene: BenchScene, density_m2: float) -> BenchScene:
    """The same scene with points taken at random, so many per square metre of the cells of 2 m that hold any."""

    def load() -> Cloud:
        cloud = scene.load()
        cells = len(np.unique(np.floor(cloud.xyz[:, :2] / 2.0), axis=0))
        rng = np.random.default_rng(1)
        kept = rng.random(len(cloud.xyz)) < density_m2 * 4.0 * cells / len(cloud.xyz)
        rgb, returns = (None if c is None else c[kept] for c in (cloud.rgb, cloud.returns))
        return replace(
            cloud,
            xyz=cloud.xyz[kept],
            classification=cloud.classification[kept],
            rgb=rgb,
            returns=returns,
        )

    return replace(scene, load=load, recipe=f"{scene.recipe} thinned to {density_m2:g}")


def bilinear(heights: np.ndarray, pixel_m: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Heights between the centres of a raster's pixels, rows from north to south; NaN beside pixels without a height.

    (0, 0) is the south-west corner of the raster.
    """
    from scipy.ndimage import map_coordinates

    rows, columns = heights.shape[0] - y / pixel_m - 0.5, x / pixel_m - 0.5
    found: np.ndarray = map_coordinates(
        heights, [rows, columns], order=1, mode="constant", cval=np.nan
    )
    return found


def simulated_scenes() -> Iterator[BenchScene]:
    """The scenes of the simulator's catalogue."""
    from tiler.simulate.catalogue import SCENES, SENSORS
    from tiler.simulate.sites import SITES

    sources = digest_of_modules(
        *(maker.__module__ for maker in (*SENSORS.values(), *SITES.values()))
    )
    for name, spec in SCENES.items():
        if spec.scene_class == "als water":  # these have a benchmark of their own
            continue
        family, load = f"simulated {spec.scene_class}", partial(simulated, name)
        yield BenchScene(name, family, SIMULATED[spec.kind], load, recipe=f"{spec} {sources}")


def simulated(name: str) -> Cloud:
    """A scene of the simulator."""
    from tiler.simulate.catalogue import make_scene

    scene = make_scene(name)
    return Cloud(
        scene.xyz,
        scene.classification,
        scene.rgb,
        scene.returns,
        scene.truth,
        scene.spec.side_m,
    )
