"""Other people's filters, where they are installed: from float64 [n, 3] in metres to what is ground, bool [n]."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tests.benchmarks.kept import digest, digest_of_modules

Filter = Callable[[np.ndarray], np.ndarray]

SMRF_ALONE: tuple[dict[str, Any], ...] = ({"type": "filters.smrf"},)
SMRF_WITHOUT_OUTLIERS: tuple[dict[str, Any], ...] = (
    {"type": "filters.elm"},
    {"type": "filters.outlier"},
    {"type": "filters.smrf", "ignore": "Classification[7:7]"},
)
"""What PDAL's documentation advises: low points and outliers become class 7, which the filter
then does not see."""
PMF_ALONE: tuple[dict[str, Any], ...] = ({"type": "filters.pmf"},)


PEER = "(peer)"
"""How names of other people's filters end."""


class Cloth(NamedTuple):
    """Settings of the cloth simulation: its spacing in metres, and 1 (soft, for steep terrain) to 3 (stiff, flat)."""

    resolution_m: float
    rigidness: int


CLOTH_DEFAULT = Cloth(1.0, 3)
CLOTHS = (Cloth(0.5, 1), Cloth(1.0, 2), Cloth(2.0, 3))
"""Declared beforehand."""
CLOTH_BEST = Cloth(1.0, 2)
"""Of these, the one with the least mean total error on the semi-real matched scenes
(`tests/benchmarks/matched.py`)."""


def csf(xyz: np.ndarray, cloth: Cloth = CLOTH_DEFAULT) -> np.ndarray:
    """Cloth simulation (Zhang et al. 2016); all else as its Python package has it."""
    CSF = importlib.import_module("CSF")
    simulation = CSF.CSF()
    simulation.params.cloth_resolution, simulation.params.rigidness = cloth
    simulation.setPointCloud(np.ascontiguousarray(xyz - xyz.min(axis=0)))
    ground, rest = CSF.VecInt(), CSF.VecInt()
    with silent():
        simulation.do_filtering(ground, rest, False)
    found = np.zeros(len(xyz), bool)
    found[np.array(ground, np.intp)] = True
    return found


def pdal_ground(stages: tuple[dict[str, Any], ...], xyz: np.ndarray) -> np.ndarray:
    """What stages of a PDAL pipeline leave as class 2."""
    pdal = importlib.import_module("pdal")
    points = np.zeros(
        len(xyz), [("X", "f8"), ("Y", "f8"), ("Z", "f8"), ("Classification", "u1")]
    )
    for axis, column in zip("XYZ", xyz.T, strict=True):
        points[axis] = column
    pipeline = pdal.Pipeline(json.dumps(list(stages)), arrays=[points])
    pipeline.execute()
    return np.asarray(pipeline.arrays[0]["Classification"] == 2)


def lasr_ptd(xyz: np.ndarray) -> np.ndarray:
    """Progressive TIN densification of lasR (R), with its defaults, through files."""
    program = (
        "a <- commandArgs(TRUE); library(lasR); "
        "invisible(exec(classify_with_ptd() + write_las(a[2]), on = a[1]))"
    )

    def label(cloud: Path, out: Path) -> None:
        call = ["Rscript", "-e", program, str(cloud), str(out)]
        subprocess.run(call, check=True, stdout=subprocess.DEVNULL)

    return _through_files(xyz, label)


def whitebox_ground(xyz: np.ndarray) -> np.ndarray:
    """Improved ground point filter of Whitebox Workflows, with its defaults, through files."""
    environment = importlib.import_module("whitebox_workflows").WbEnvironment()

    tools = environment.lidar.filtering_classification

    def label(cloud: Path, out: Path) -> None:
        points = environment.read_lidar(str(cloud))
        with silent():
            tools.improved_ground_point_filter(input=points, classify=True, output=str(out))

    return _through_files(xyz, label)


def smrf_ground(xyz: np.ndarray) -> np.ndarray:
    """Simple morphological filter of pysmrf, with the one setting of Pingel et al. (2013) for all ISPRS samples."""
    smrf = importlib.import_module("pysmrf").smrf
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Its own use of libraries is deprecated.
        found = smrf(
            *xyz.T, cellsize=1.0, windows=18, slope_threshold=0.15, elevation_threshold=0.5
        )
    return ~np.asarray(found[3], np.bool_)


def _through_files(xyz: np.ndarray, label: Callable[[Path, Path], object]) -> np.ndarray:
    """What a program that reads one LAS file and writes another one leaves as class 2."""
    import laspy

    with tempfile.TemporaryDirectory() as folder:
        cloud, out = Path(folder, "cloud.las"), Path(folder, "out.las")
        las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
        las.header.scales, las.header.offsets = np.full(3, 0.001), np.floor(xyz.min(axis=0))
        las.xyz = xyz
        las.return_number = las.number_of_returns = np.ones(len(xyz), np.uint8)
        las.write(cloud)
        label(cloud, out)
        found = laspy.read(out)
    # Points may come in another order: they are told by their place.
    return np.asarray(found.classification == 2)[_same_order(las, found)]


def _same_order(given: Any, found: Any) -> np.ndarray:
    """Where each given point is among those found."""
    order, other = (
        np.lexsort([np.rint(las[c] * 1000) for c in "zyx"]) for las in (given, found)
    )
    back = np.empty_like(order)
    back[order] = other
    return back


def cloth_name(cloth: Cloth) -> str:
    """A heading for a table, without commas, which part names on the command line."""
    if cloth == CLOTH_DEFAULT:
        return "CSF (peer)"
    return f"CSF {cloth.resolution_m:g} m rigidness {cloth.rigidness} (peer)"


def installed_peers(every_cloth: bool = False) -> dict[str, Filter]:
    """Filters by name; empty where none is installed. Of the cloth's settings the default and the best, or all."""
    found: dict[str, Filter] = {}
    if installed("CSF"):
        cloths = CLOTHS if every_cloth else (CLOTH_BEST,)
        found |= {
            cloth_name(cloth): partial(csf, cloth=cloth) for cloth in (CLOTH_DEFAULT, *cloths)
        }
    if installed("pdal"):
        found["PDAL SMRF (peer)"] = partial(pdal_ground, SMRF_ALONE)
        found["PDAL SMRF without outliers (peer)"] = partial(pdal_ground, SMRF_WITHOUT_OUTLIERS)
        found["PDAL PMF (peer)"] = partial(pdal_ground, PMF_ALONE)
    if _has_lasr():
        found["lasR PTD (peer)"] = lasr_ptd
    return found


LASER_PEERS: dict[str, tuple[str, str, Filter]] = {
    "pysmrf (peer)": ("pysmrf", "pysmrf", smrf_ground),
    "Whitebox (peer)": ("whitebox_workflows", "whitebox-workflows", whitebox_ground),
}
"""Filters for laser scans that pip installs: module, package, and function by name."""


def laser_peers() -> dict[str, Filter]:
    """Filters for laser scans by name; empty where none is installed."""
    return {
        name: label for name, (module, _, label) in LASER_PEERS.items() if installed(module)
    }


def missing_laser_peers() -> dict[str, str]:
    """Filters for laser scans that do not take part, and why."""
    return {
        name.removesuffix(f" {PEER}"): f"not installed: pip install {package}"
        for name, (module, package, _) in LASER_PEERS.items()
        if not installed(module)
    }


def digest_of_peers() -> str:
    """A key of what the peers' labels follow from, but for PDAL and lasR themselves."""
    packages = ("cloth-simulation-filter", "pdal")
    found = {
        d.metadata["Name"]: d.version
        for name in packages
        for d in importlib.metadata.distributions(name=name)
    }
    return digest(digest_of_modules(__name__), repr(sorted(found.items())))


def missing_peers() -> dict[str, str]:
    """Filters that do not take part, and why."""
    found = {}
    if not _has_lasr():
        found["lasR PTD"] = (
            "not installed: a package of R that Debian 12 does not have; its binding for Python, pylasr, has no wheel"
        )
    if not installed("CSF"):
        found["CSF"] = "not installed: pip install cloth-simulation-filter"
    if not installed("pdal"):
        found["PDAL SMRF, PMF"] = (
            "not installed: its Python package has no wheel and needs PDAL itself, which Debian 12 does not have"
        )
    return found


@contextmanager
def silent() -> Iterator[None]:
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


@cache
def _has_lasr() -> bool:
    """Whether R and its package lasR are installed."""
    program = "quit(status = !requireNamespace('lasR', quietly = TRUE))"
    return (
        shutil.which("Rscript") is not None and subprocess.call(["Rscript", "-e", program]) == 0
    )


def installed(module: str) -> bool:
    return importlib.util.find_spec(module) is not None
