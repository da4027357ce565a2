"""Small clouds with classes."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np


def write_cloud(path: Path, xyz: np.ndarray, classes: np.ndarray, scale: float = 0.01) -> Path:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, scale)
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = xyz.T
    cloud.classification = classes
    cloud.write(path)
    return path
