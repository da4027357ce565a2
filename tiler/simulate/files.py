"""Scenes as files: a cloud with reference classes, and its reference terrain next to it."""

from __future__ import annotations

import dataclasses
import os
import time
from contextlib import suppress
from pathlib import Path

import numpy as np

from tiler.errors import ConfigError, ProcessingError
from tiler.io.atomic_files import clear_partial, partial_path, replace_file
from tiler.observe.events import Listener, StageFinished, StageStarted, TaskDone, ignore_events
from tiler.simulate.catalogue import SCENES, SENSORS, SceneSpec
from tiler.simulate.cloud import CloudWriter, write_dtm
from tiler.simulate.points import CLASS_NAMES, Sensor, patches, survey_patch
from tiler.simulate.site import Site
from tiler.simulate.sites import SITES

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
        write_dtm(dtm_part, site, pixel_m)
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
