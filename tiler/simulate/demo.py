"""The simulated city as files: clouds as a run gets them, with their true classes, and the true terrain."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyproj

from tiler.core.classes import UNCLASSIFIED
from tiler.export.geotiff import TILE, RasterLook, plain_geotiff
from tiler.simulate.city import Scene, city
from tiler.simulate.sensor import AlsSensor, Returns, scan
from tiler.simulate.terrain import Terrain

CRS = "EPSG:32632"
ORIGIN = (500_000.0, 5_400_000.0)
"""Coordinates of the scene's south-west corner."""

CELL_M = 150.0
"""Side of the pieces that are simulated at once: bounds the memory, and the seed of each is its own."""


@dataclass(frozen=True)
class DemoScene:
    """What `demo_city` wrote.

    Attributes
    ----------
    paths, truth_paths : tuple of Path
        Four clouds (classes 0 and 1), and the same rows with the true classes.
    dtm_path : Path
        The true terrain, float32 GeoTIFF.
    terrain : Terrain
        The formula behind it, in metres from `ORIGIN`.
    points : int
        In all four clouds together.
    """

    paths: tuple[Path, ...]
    truth_paths: tuple[Path, ...]
    dtm_path: Path
    terrain: Terrain
    points: int


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
        Created if it is not there; files of these names are replaced.
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
    scene, sensor = city(seed, side_m), sensor or AlsSensor()
    paths, truth_paths, points = [], [], 0
    half = side_m / 2
    for part, name in enumerate(("sw", "se", "nw", "ne")):
        x0, y0 = half * (part % 2), half * (part // 2)
        paths.append(folder / f"city_{name}.laz")
        truth_paths.append(folder / "truth" / f"city_{name}.laz")
        box = (x0, y0, x0 + half, y0 + half)
        points += _write_part(paths[-1], truth_paths[-1], scene, sensor, box, (seed, part))
    dtm_path = folder / "truth" / "dtm.tif"
    _write_dtm(dtm_path, scene, dtm_m)
    return DemoScene(tuple(paths), tuple(truth_paths), dtm_path, scene.terrain, points)


def _header() -> laspy.LasHeader:
    """LAS 1.4, point format 6, centimetres; no date of today, so that the same scene has the same bytes."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, 0.01)
    header.offsets = np.array([*ORIGIN, 0.0])
    header.creation_date = datetime.date(2020, 1, 1)
    header.generating_software = "tiler simulate"
    header.add_crs(pyproj.CRS(CRS))
    return header


def _write_part(
    path: Path, truth_path: Path, scene: Scene, sensor: AlsSensor, box: tuple[float, float, float, float],
    seed: tuple[int, int],
) -> int:  # fmt: skip
    """One cloud and its truth, piece by piece; returns the number of points."""
    pieces = max(1, int(np.ceil((box[2] - box[0]) / CELL_M)))
    edges_x, edges_y = np.linspace(box[0], box[2], pieces + 1), np.linspace(box[1], box[3], pieces + 1)
    points, pulses = 0, 0.0
    with (
        laspy.open(path, "w", header=_header()) as cloud,
        laspy.open(truth_path, "w", header=_header()) as truth,
    ):
        for row in range(pieces):
            for column in range(pieces):
                rng = np.random.Generator(np.random.PCG64([*seed, row, column]))
                piece = (edges_x[column], edges_y[row], edges_x[column + 1], edges_y[row + 1])
                returns = scan(scene.terrain, scene.objects, sensor, piece, rng)
                record = _record(cloud.header, returns, pulses)
                pulses += len(record) * 1e-5
                record["classification"] = np.where(returns.label == UNCLASSIFIED, 0, 1)
                cloud.write_points(record)
                record["classification"] = returns.label
                truth.write_points(record)
                points += len(record)
    return points


def _record(header: laspy.LasHeader, returns: Returns, first_second: float) -> Any:
    """Returns as points of the header's format."""
    record = laspy.ScaleAwarePointRecord.zeros(len(returns.label), header=header)
    counts = returns.xyz / 0.01
    # x and y are cut off, as rounding could put a point on the edge that belongs to the next file.
    record["X"], record["Y"] = np.floor(counts[:, :2] + 1e-6).astype(np.int32).T
    record["Z"] = np.round(counts[:, 2]).astype(np.int32)
    record["return_number"] = returns.number
    record["number_of_returns"] = returns.count
    record["scan_angle"] = np.round(returns.angle_deg / 0.006).astype(np.int16)
    record["gps_time"] = first_second + np.cumsum(returns.number == 1) * 1e-5
    record["point_source_id"] = np.ones(len(returns.label), np.uint16)
    return record


def _write_dtm(path: Path, scene: Scene, size: float) -> None:
    """The true height at the centre of each pixel, in blocks of rows."""
    pixels = int(np.ceil(scene.side_m / size))
    top = pixels * size
    x = (np.arange(pixels) + 0.5) * size
    transform = (size, 0.0, ORIGIN[0], 0.0, -size, ORIGIN[1] + top)
    look = RasterLook(CRS, "metre", "true terrain height", {})
    with plain_geotiff(path, pixels, pixels, transform, look) as raster:
        for row in range(0, pixels, TILE):
            rows = np.arange(row, min(row + TILE, pixels))
            y = top - (rows + 0.5) * size
            raster.write(scene.terrain.height_at(x[None, :], y[:, None]).astype(np.float32), row, 0)
