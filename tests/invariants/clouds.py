"""Simulated clouds as files, in the shapes that tiles find hard."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import laspy
import numpy as np
from pyproj import CRS

from tiler.simulate import AlsSensor, scene_points

CORNER = (500_000.0, 5_400_000.0)
SIDE_M = 192.0


@dataclass(frozen=True)
class Cloud:
    """``xyz``: float64 (n, 3), metres from `CORNER`, whole millimetres; ``truth``: uint8 (n,), ASPRS."""

    xyz: np.ndarray
    truth: np.ndarray

    def take(self, keep: np.ndarray) -> Cloud:
        return Cloud(self.xyz[keep], self.truth[keep])

    def __len__(self) -> int:
        return len(self.truth)


def city(
    side_m: float = SIDE_M, density: float = 1.0, seed: int = 1, kind: str = "city"
) -> Cloud:
    xyz, truth = scene_points(kind, seed, side_m, AlsSensor(density=density))
    return Cloud(np.round(xyz, 3), truth)


def _inside(cloud: Cloud) -> tuple[np.ndarray, np.ndarray]:
    return cloud.xyz[:, 0] / SIDE_M, cloud.xyz[:, 1] / SIDE_M


def void(cloud: Cloud) -> Cloud:
    """A lake in the middle."""
    x, y = _inside(cloud)
    return cloud.take((abs(x - 0.45) > 0.2) | (abs(y - 0.55) > 0.2))


def river(cloud: Cloud) -> Cloud:
    """Nothing on a winding band from side to side."""
    x, y = _inside(cloud)
    return cloud.take(abs(y - 0.5 - 0.2 * np.sin(6 * x)) > 0.12)


def l_shape(cloud: Cloud) -> Cloud:
    x, y = _inside(cloud)
    return cloud.take((x < 0.4) | (y < 0.35))


def islands(cloud: Cloud) -> Cloud:
    """Three pieces of land far from one another."""
    x, y = _inside(cloud)
    centres = ((0.15, 0.2), (0.8, 0.15), (0.6, 0.85))
    near = [(x - cx) ** 2 + (y - cy) ** 2 < 0.17**2 for cx, cy in centres]
    return cloud.take(np.logical_or.reduce(near))


def flight_line(cloud: Cloud) -> Cloud:
    """A narrow diagonal strip."""
    x, y = _inside(cloud)
    return cloud.take(abs(x - y) < 0.16)


SHAPES: dict[str, Callable[[Cloud], Cloud]] = {
    "full": lambda cloud: cloud,
    "void": void,
    "river": river,
    "l-shape": l_shape,
    "islands": islands,
    "flight line": flight_line,
}


def quarters(cloud: Cloud, side_m: float = SIDE_M) -> list[Cloud]:
    """The four quarters, unequal ones; each point in one of them."""
    east, north = cloud.xyz[:, 0] > 0.4 * side_m, cloud.xyz[:, 1] > 0.55 * side_m
    return [
        cloud.take((east == e) & (north == n)) for n in (False, True) for e in (False, True)
    ]


def write(
    path: Path,
    cloud: Cloud,
    *,
    classes: np.ndarray | None = None,
    withheld: np.ndarray | None = None,
    corner: Sequence[float] = CORNER,
    crs: str | None = "EPSG:32632",
) -> Path:
    """Write a cloud, unclassified but for ``classes``."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.array([*corner, 0.0])
    if crs is not None:
        wkt = CRS.from_user_input(crs).to_wkt("WKT1_GDAL") + "\0"
        header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "WKT", wkt.encode()))
        header.global_encoding.wkt = True
    las = laspy.LasData(header)
    las.points = laspy.ScaleAwarePointRecord.zeros(len(cloud), header=header)
    for name, column in zip("XYZ", cloud.xyz.T, strict=True):
        las.points.array[name] = np.round(column * 1000)
    las.classification = np.full(len(cloud), 1, np.uint8) if classes is None else classes
    las.return_number[:] = las.number_of_returns[:] = 1
    las.gps_time = np.arange(len(cloud), dtype=np.float64)
    if withheld is not None:
        las.withheld = withheld
    path.parent.mkdir(parents=True, exist_ok=True)
    las.write(path)
    return path
