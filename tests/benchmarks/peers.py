"""Other people's filters, where they are installed: from float64 [n, 3] in metres to what is ground, bool [n]."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable

import numpy as np

Filter = Callable[[np.ndarray], np.ndarray]


def csf(xyz: np.ndarray) -> np.ndarray:
    """Cloth simulation (Zhang et al. 2016) with its defaults."""
    CSF = importlib.import_module("CSF")
    cloth = CSF.CSF()
    cloth.setPointCloud(np.ascontiguousarray(xyz - xyz.min(axis=0)))
    ground, rest = CSF.VecInt(), CSF.VecInt()
    cloth.do_filtering(ground, rest, False)
    found = np.zeros(len(xyz), bool)
    found[np.array(ground, np.intp)] = True
    return found


def pdal_filter(name: str, xyz: np.ndarray) -> np.ndarray:
    """``filters.<name>`` of PDAL with its defaults."""
    pdal = importlib.import_module("pdal")
    points = np.zeros(len(xyz), [("X", "f8"), ("Y", "f8"), ("Z", "f8"), ("Classification", "u1")])
    for axis, column in zip("XYZ", xyz.T, strict=True):
        points[axis] = column
    pipeline = getattr(pdal.Filter, name)().pipeline(points)
    pipeline.execute()
    return np.asarray(pipeline.arrays[0]["Classification"] == 2)


def installed_peers() -> dict[str, Filter]:
    """Filters by name; empty where none is installed."""
    found: dict[str, Filter] = {}
    if importlib.util.find_spec("CSF") is not None:
        found["CSF (peer)"] = csf
    if importlib.util.find_spec("pdal") is not None:
        found["PDAL SMRF (peer)"] = lambda xyz: pdal_filter("smrf", xyz)
        found["PDAL PMF (peer)"] = lambda xyz: pdal_filter("pmf", xyz)
    return found
