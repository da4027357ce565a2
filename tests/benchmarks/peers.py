"""Other people's filters, where they are installed: from float64 [n, 3] in metres to what is ground, bool [n]."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

import numpy as np

Filter = Callable[[np.ndarray], np.ndarray]

SMRF_ALONE: tuple[dict[str, Any], ...] = ({"type": "filters.smrf"},)
SMRF_WITHOUT_OUTLIERS: tuple[dict[str, Any], ...] = (
    {"type": "filters.elm"},
    {"type": "filters.outlier"},
    {"type": "filters.smrf", "ignore": "Classification[7:7]"},
)
"""What PDAL's documentation advises: low points and outliers become class 7, which the filter then does not see."""
PMF_ALONE: tuple[dict[str, Any], ...] = ({"type": "filters.pmf"},)


class Cloth(NamedTuple):
    """Settings of the cloth simulation: its spacing in metres, and 1 (soft, for steep terrain) to 3 (stiff, flat)."""

    resolution_m: float
    rigidness: int


CLOTH_DEFAULT = Cloth(1.0, 3)
CLOTHS = (Cloth(0.5, 1), Cloth(1.0, 2), Cloth(2.0, 3))
"""Declared beforehand."""
CLOTH_BEST = Cloth(1.0, 2)
"""Of these, the one with the least mean total error on the semi-real matched scenes (`tests/benchmarks/matched.py`)."""


def csf(xyz: np.ndarray, cloth: Cloth = CLOTH_DEFAULT) -> np.ndarray:
    """Cloth simulation (Zhang et al. 2016); all else as its Python package has it."""
    CSF = importlib.import_module("CSF")
    simulation = CSF.CSF()
    simulation.params.cloth_resolution, simulation.params.rigidness = cloth
    simulation.setPointCloud(np.ascontiguousarray(xyz - xyz.min(axis=0)))
    ground, rest = CSF.VecInt(), CSF.VecInt()
    with _silent():
        simulation.do_filtering(ground, rest, False)
    found = np.zeros(len(xyz), bool)
    found[np.array(ground, np.intp)] = True
    return found


def pdal_ground(stages: tuple[dict[str, Any], ...], xyz: np.ndarray) -> np.ndarray:
    """What stages of a PDAL pipeline leave as class 2."""
    pdal = importlib.import_module("pdal")
    points = np.zeros(len(xyz), [("X", "f8"), ("Y", "f8"), ("Z", "f8"), ("Classification", "u1")])
    for axis, column in zip("XYZ", xyz.T, strict=True):
        points[axis] = column
    pipeline = pdal.Pipeline(json.dumps(list(stages)), arrays=[points])
    pipeline.execute()
    return np.asarray(pipeline.arrays[0]["Classification"] == 2)


def cloth_name(cloth: Cloth) -> str:
    """A heading for a table, without commas, which part names on the command line."""
    if cloth == CLOTH_DEFAULT:
        return "CSF (peer)"
    return f"CSF {cloth.resolution_m:g} m rigidness {cloth.rigidness} (peer)"


def installed_peers(every_cloth: bool = False) -> dict[str, Filter]:
    """Filters by name; empty where none is installed. Of the cloth's settings the default and the best, or all."""
    found: dict[str, Filter] = {}
    if _installed("CSF"):
        cloths = CLOTHS if every_cloth else (CLOTH_BEST,)
        found |= {cloth_name(cloth): partial(csf, cloth=cloth) for cloth in (CLOTH_DEFAULT, *cloths)}
    if _installed("pdal"):
        found["PDAL SMRF (peer)"] = partial(pdal_ground, SMRF_ALONE)
        found["PDAL SMRF without outliers (peer)"] = partial(pdal_ground, SMRF_WITHOUT_OUTLIERS)
        found["PDAL PMF (peer)"] = partial(pdal_ground, PMF_ALONE)
    return found


def missing_peers() -> dict[str, str]:
    """Filters that do not take part, and why."""
    found = {"lasR PTD": "lasR has no package for this system in PyPI or Debian"}
    if not _installed("CSF"):
        found["CSF"] = "not installed: pip install cloth-simulation-filter"
    if not _installed("pdal"):
        found["PDAL SMRF, PMF"] = (
            "not installed: its Python package needs PDAL itself, which Debian 12 does not have"
        )
    return found


@contextmanager
def _silent() -> Iterator[None]:
    """Without what a compiled library prints to the standard output, where tables go."""
    sys.stdout.flush()
    kept = os.dup(1)
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def _installed(module: str) -> bool:
    return importlib.util.find_spec(module) is not None
