"""Clouds of pulses on a square lattice, whose density, holes and swaths are known by formula."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import laspy
import numpy as np
from pyproj import CRS

ALL = "EPSG:25832+5783"
"""Horizontal CRS in metres with a vertical one."""


def lattice(
    x0: float, x1: float, y0: float, y1: float, spacing: float = 0.5
) -> tuple[np.ndarray, np.ndarray]:
    """Centres of squares of the pulse spacing."""
    x = np.arange(x0 + spacing / 2, x1, spacing)
    y = np.arange(y0 + spacing / 2, y1, spacing)
    columns, rows = np.meshgrid(x, y)
    return columns.ravel(), rows.ravel()


class Pulses:
    """Pulses of swaths, which may be cut, shuffled and written."""

    def __init__(self, x: np.ndarray, y: np.ndarray, source: int = 1) -> None:
        self.x, self.y = x, y
        self.z = 100 + np.round(0.1 * x + 0.05 * y, 2)
        self.source = np.full(x.size, source)
        self.time = np.arange(x.size) * 1e-3 + 1e6 * source + 3e8

    def take(self, rows: np.ndarray) -> Pulses:
        taken = Pulses.__new__(Pulses)
        for name, column in vars(self).items():
            setattr(taken, name, column[rows])
        return taken

    def where(self, keeps: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Pulses:
        return self.take(keeps(self.x, self.y))

    def __add__(self, other: Pulses) -> Pulses:
        both = Pulses.__new__(Pulses)
        for name, column in vars(self).items():
            setattr(both, name, np.concatenate((column, getattr(other, name))))
        return both

    def write(
        self,
        path: Path,
        crs: str | None = ALL,
        metres: float = 1.0,
        change: Callable[[Any], None] = lambda las: None,
        point_format: int = 6,
    ) -> Path:
        """Write a perfect file, but for what ``change`` does to it."""
        header = laspy.LasHeader(point_format=point_format, version="1.4")
        header.scales, header.offsets = np.full(3, 0.001), np.array([5e5, 5e6, 0.0])
        header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
        if crs is not None:
            header.add_crs(CRS.from_user_input(crs))
        las = laspy.LasData(header)
        las.x, las.y, las.z = 5e5 + self.x / metres, 5e6 + self.y / metres, self.z
        las.return_number[:] = las.number_of_returns[:] = 1
        las.classification = np.full(self.x.size, 2, np.uint8)
        las.intensity = np.full(self.x.size, 500, np.uint16)
        las.point_source_id = self.source.astype(np.uint16)
        las.gps_time = self.time
        change(las)
        las.write(path)
        return path
