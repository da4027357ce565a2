"""Scenes as files: a cloud with reference classes, and its reference terrain next to it.

The demo has four clouds of one simulated city.
"""

from __future__ import annotations

import dataclasses
import datetime
import os
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyproj

from ptd.arrays import UInt8
from tiler.core.points import UNCLASSIFIED
from tiler.core.raster import BLOCK_PIXELS
from tiler.errors import ConfigError, ProcessingError
from tiler.io.atomic_files import clear_partial, partial_path, replace_file
from tiler.io.raster_files import RasterMetadata, plain_geotiff
from tiler.observe.events import Listener, StageFinished, StageStarted, TaskDone, ignore_events
from tiler.simulate.als import AlsSensor
from tiler.simulate.catalogue import SCENES, SENSORS, SceneSpec
from tiler.simulate.points import CLASS_NAMES, Sensor, SimulatedPoints, patches, survey_patch
from tiler.simulate.site import Site
from tiler.simulate.sites import SITES, city
from tiler.simulate.terrain import Terrain

CRS = "EPSG:32632"
ORIGIN = (500_000.0, 5_400_000.0)
"""Coordinates of a site's south-west corner in `CRS`, metres."""

PULSE_S = 1e-5
"""Time between pulses, seconds."""


class CloudWriter:
    """Writer of a LAZ or LAS file: LAS 1.4, point format 6, or 7 with colours, in millimetres.

    The header contains neither the current date nor a version, so the same points give the same
    bytes.

    Parameters
    ----------
    path : Path
        File to write. An existing file is replaced.
    colour, compressed : bool
    pulsed : bool
        Whether the points are returns of pulses. Points from images have no GPS time.
    """

    def __init__(
        self, path: Path, colour: bool = False, compressed: bool = True, pulsed: bool = True
    ) -> None:
        header = laspy.LasHeader(point_format=7 if colour else 6, version="1.4")
        header.scales = np.full(3, 0.001)
        header.offsets = np.array([*ORIGIN, 0.0])
        header.creation_date = datetime.date(2020, 1, 1)
        header.generating_software = "tiler simulate"
        header.add_crs(pyproj.CRS(CRS))
        self.points = 0
        self._pulses, self._pulsed = 0, pulsed
        self._header = header
        self._file: Any = laspy.open(path, "w", header=header, do_compress=compressed)

    def __enter__(self) -> CloudWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def write(self, points: SimulatedPoints, classes: UInt8 | None = None) -> None:
        """Append points. If given, ``classes`` (uint8, shape (n,)) replaces their labels."""
        if not len(points):
            return
        las = laspy.ScaleAwarePointRecord.zeros(len(points), header=self._header)
        for name, column in zip("XYZ", points.xyz.T, strict=True):
            las[name] = np.rint(column * 1000).astype(np.int32)
        las["classification"] = classes if classes is not None else points.label
        las["return_number"], las["number_of_returns"] = points.number, points.count
        las["scan_angle"] = np.round(points.angle_deg / 0.006).astype(np.int16)
        pulse = self._pulses + np.cumsum(points.number == 1)
        las["point_source_id"] = np.ones(len(points), np.uint16)
        if self._pulsed:
            las["gps_time"] = pulse * PULSE_S
        if points.rgb is not None:
            las["red"], las["green"], las["blue"] = points.rgb.T
        self._file.write_points(las)
        self._pulses = int(pulse[-1])
        self.points += len(points)


def _write_dtm(path: Path, site: Site, pixel_m: float) -> None:
    """Write the reference height at the centre of each pixel, float32, block by block.

    Parameters
    ----------
    path : Path
        GeoTIFF to write. An existing file is replaced.
    site : Site
    pixel_m : float
        Side of a pixel, metres.
    """
    columns, rows = (int(np.ceil(extent / pixel_m)) for extent in (site.side_m, site.north_m))
    top = rows * pixel_m
    x = (np.arange(columns) + 0.5) * pixel_m
    transform = (pixel_m, 0.0, ORIGIN[0], 0.0, -pixel_m, ORIGIN[1] + top)
    look = RasterMetadata(CRS, "metre", "true terrain height", {})
    with plain_geotiff(path, rows, columns, transform, look) as raster:
        for row in range(0, rows, BLOCK_PIXELS):
            y = top - (np.arange(row, min(row + BLOCK_PIXELS, rows)) + 0.5) * pixel_m
            for column in range(0, columns, BLOCK_PIXELS):
                heights = site.terrain.height_at(
                    x[None, column : column + BLOCK_PIXELS], y[:, None]
                )
                raster.write(heights.astype(np.float32), row, column)


DEFAULT_SIDE_M = {"als": 500.0, "dim": 150.0}
DENSITY_RANGE = {"als": (0.05, 100.0), "dim": (1.0, 1000.0)}
"""Smallest and largest number of points per square metre.

The densest scene needs 750 MB of memory."""

STAGE = "simulate"
"""Key of the stage in the progress."""

SIDE_RANGE_M = (50.0, 50_000.0)
SIGMA_RANGE_M = (0.0, 1.0)
BLUNDERS_RANGE = (0.0, 100.0)
PIXEL_RANGE_M = (0.05, 100.0)


def describe_scene(
    scene: str = "city",
    kind: str | None = None,
    *,
    seed: int | None = None,
    side_m: float | None = None,
    density: float | None = None,
    sigma_m: float | None = None,
    blunders: float = 1.0,
) -> SceneSpec:
    """Describe a scene of the catalogue, or of a kind of site, with changed settings.

    Parameters
    ----------
    scene : str
        Name in `tiler.simulate.SCENES` or `tiler.simulate.SITES`.
    kind : {'als', 'dim'}, optional
        Kind of the sensor. The default is the kind of the catalogue's scene, or ``als``.
    seed : int, optional
        Seed of the scene. The default is the seed of the catalogue's scene, or 1.
    side_m, density, sigma_m : float, optional
        Side in metres, points per square metre, and standard deviation of heights in metres. Defaults are the values
        of the catalogue's scene, or `DEFAULT_SIDE_M` and the defaults of the sensor.
    blunders : float
        Factor of the usual number of low and high blunders.

    Raises
    ------
    ConfigError
        If the name or the kind is unknown, the kind differs from the kind of the catalogue's scene, or a value is
        out of range.
    """
    if scene in SCENES:
        spec = SCENES[scene]
        if kind not in (None, spec.kind):
            raise ConfigError(
                f"--kind {kind}: scene {scene} is of kind {spec.kind}; use --scene {spec.site}"
            )
    elif scene in SITES:
        kind = kind or "als"
        if kind not in SENSORS:
            raise ConfigError(f"--kind {kind}: choose one of {', '.join(SENSORS)}")
        spec = SceneSpec(scene, kind, "", f"{kind} {scene}", scene, 1, DEFAULT_SIDE_M[kind])
    else:
        names = ", ".join((*SITES, *SCENES))
        raise ConfigError(f"unknown scene {scene!r}: choose one of {names}")
    sensor = dict(spec.sensor)
    if density is not None:
        sensor["density"] = _within(
            "--density", density, *DENSITY_RANGE[spec.kind], "points/m2"
        )
    if sigma_m is not None:
        sensor["sigma_m"] = _within("--sigma", sigma_m, *SIGMA_RANGE_M, "m")
    _within("--blunders", blunders, *BLUNDERS_RANGE, "times")
    defaults = SENSORS[spec.kind]
    for name in defaults.BLUNDERS:
        sensor[name] = blunders * sensor.get(name, getattr(defaults, name))
    if side_m is None:
        side_m = spec.side_m
    else:
        _within("--size", side_m, *SIDE_RANGE_M, "m")
    if seed is None:
        seed = spec.seed
    if seed < 0:
        raise ConfigError(f"--seed {seed}: must not be negative")
    return dataclasses.replace(spec, seed=seed, side_m=side_m, sensor=sensor)


@dataclasses.dataclass(frozen=True, kw_only=True)
class WrittenScene:
    """Files of a scene, and their content.

    Attributes
    ----------
    cloud, dtm : str
        Paths of the cloud and of its reference terrain.
    scene, kind : str
    seed : int
    side_m, north_m : float
        Extent from west to east, and from south to north.
    points : int
    points_per_m2 : float
    classes : dict of str to int
        Number of points by class, with keys such as ``2 ground``.
    """

    cloud: str
    dtm: str
    scene: str
    kind: str
    seed: int
    side_m: float
    north_m: float
    points: int
    points_per_m2: float
    classes: dict[str, int]


def write_scene(
    path: str | Path, spec: SceneSpec, pixel_m: float = 1.0, listener: Listener = ignore_events
) -> WrittenScene:
    """Write the cloud of a scene, and its reference terrain as ``<name>_dtm.tif`` next to it.

    Patches are simulated one by one, so the memory holds only one patch.

    Parameters
    ----------
    path : path
        LAZ or LAS file to write, in point format 6, or 7 if the scene has colours. Both files appear under their names
        once they are complete, and replace existing files. The same ``spec`` gives the same bytes.
    spec : SceneSpec
        Result of `describe_scene`.
    pixel_m : float
        Side of a pixel of the reference terrain, metres.
    listener : Listener
        Receives events.

    Raises
    ------
    ConfigError
        If the suffix is neither LAZ nor LAS, a file with the terrain's name exists without the cloud, or ``pixel_m``
        is out of range.
    ProcessingError
        If a file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in (".laz", ".las"):
        raise ConfigError(
            f"{path}: a simulated cloud is LAZ or LAS; give it a name that ends in .laz"
        )
    _within("--resolution", pixel_m, *PIXEL_RANGE_M, "m")
    dtm = path.with_name(f"{path.stem}_dtm.tif")
    if os.path.lexists(dtm) and not os.path.lexists(path):
        raise ConfigError(f"{dtm}: already exists, but its cloud does not; give another name")
    part, dtm_part = (partial_path(target) for target in (path, dtm))
    site = spec.make_site()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        clear_partial(part)
        clear_partial(dtm_part)
        counts = _write_cloud(
            part, path.suffix.lower() == ".laz", site, spec.make_sensor(), listener
        )
        _write_dtm(dtm_part, site, pixel_m)
        replace_file(part, path)
        replace_file(dtm_part, dtm)
    except OSError as error:
        raise ProcessingError(
            f"{path}: cannot be written ({error.strerror or error}); check free space and permissions"
        ) from error
    finally:
        for scratch in (part, dtm_part):
            with suppress(OSError):
                scratch.unlink(missing_ok=True)
    points = int(counts.sum())
    return WrittenScene(
        cloud=str(path),
        dtm=str(dtm),
        scene=spec.name,
        kind=spec.kind,
        seed=spec.seed,
        side_m=site.side_m,
        north_m=site.north_m,
        points=points,
        points_per_m2=round(points / (site.side_m * site.north_m), 3),
        classes={
            f"{value} {CLASS_NAMES[value]}": int(counts[value])
            for value in np.flatnonzero(counts).tolist()
        },
    )


def _write_cloud(
    path: Path, compressed: bool, site: Site, sensor: Sensor, listener: Listener
) -> np.ndarray:
    """Write all patches to a file. Return the points per class, int64, shape (256,)."""
    todo = patches(sensor, site.side_m, site.north_m)
    counts = np.zeros(256, np.int64)
    started = time.monotonic()
    listener(StageStarted(STAGE, "simulate the cloud", tasks=len(todo)))
    look = {"colour": sensor.coloured, "pulsed": sensor.pulsed}
    with CloudWriter(path, compressed=compressed, **look) as cloud:
        for index in todo:
            points = survey_patch(site, sensor, *index)
            cloud.write(points)
            counts += np.bincount(points.label, minlength=256)
            listener(TaskDone(STAGE, f"{index[0]},{index[1]}", points=len(points)))
    listener(StageFinished(STAGE, time.monotonic() - started))
    return counts


def _within(option: str, value: float, low: float, high: float, unit: str) -> float:
    if not low <= value <= high:
        raise ConfigError(f"{option} {value:g}: must be between {low:g} and {high:g} {unit}")
    return value


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
        Formula of the terrain, in metres from `tiler.simulate.files.ORIGIN`.
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
    _write_dtm(dtm_path, site, dtm_m)
    return DemoScene(
        paths, truth_paths, dtm_path, site.terrain, sum(cloud.points for cloud in clouds)
    )
