"""Writers of simulated points as LAZ files, and of the reference terrain as a GeoTIFF."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyproj

from tiler.core.raster import BLOCK_PIXELS
from tiler.io.raster_files import RasterMetadata, plain_geotiff
from tiler.simulate.points import SimulatedPoints, UInt8s
from tiler.simulate.site import Site

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

    def write(self, points: SimulatedPoints, classes: UInt8s | None = None) -> None:
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


def write_dtm(path: Path, site: Site, pixel_m: float) -> None:
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
