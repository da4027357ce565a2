"""Runs of scenes whose terrain is known, for the constants of sigma: filtered and gridded as a user would."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path

import laspy
import numpy as np
from pyproj import CRS
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import KDTree

from tests.benchmarks.scorecard_scenes import (
    RAW,
    BenchScene,
    Cloud,
    real_scenes,
    semi_real_scenes,
    simulated_scenes,
)
from tiler.config import RunConfig
from tiler.core.classes import LABELS, STRAY_FLAG, WITHHELD_FLAG
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.raster import BLOCK_PIXELS, NODATA, RasterSpec
from tiler.grid.block_surroundings import PointsNear
from tiler.grid.coarse import padded
from tiler.grid.records import GroundSelection
from tiler.grid.sigma import land_margin, measures_of
from tiler.grid.stage import MATCHED_EROSION
from tiler.pipeline import run
from tiler.store import open_store, read_cells

CORNER = (500_000.0, 5_000_000.0)
"""Coordinates of the south-west corner of each scene, where its own begin at (0, 0)."""
GROUND, KNOWN_M = 2, 2.0
"""Where only the ground's points are known, the terrain is known within so many metres of
one."""
MAX_EDGE_M = Fraction(100)
"""The default of ``--max-edge``."""
WITHOUT_TRUTH = ("IGN town, thinned", "Brighton park")
"""The ground of these scenes is not complete: it was picked by another filter, or cleaned by
hand."""


@dataclass(frozen=True)
class Known:
    """A scene with truth: name, kind (``als`` or ``dim``), group (``simulated`` or ``real``), what it is made of."""

    name: str
    kind: str
    group: str
    scene: BenchScene


def known_scenes(data: Path) -> Iterator[Known]:
    """All scenes whose terrain is known, as far as their files are there."""
    for scene in simulated_scenes():
        # Where low points become ground, errors of metres are no measure of a standard error.
        if scene.family != RAW:
            yield Known(scene.name, scene.name[:3], "simulated", scene)
    for scene in semi_real_scenes(data):
        yield Known(scene.name, "dim", "real", scene)
    for scene in real_scenes(data):
        if scene.name not in WITHOUT_TRUTH:
            yield Known(scene.name.replace(" ", "_"), "als", "real", scene)


def placed(scene: BenchScene) -> Cloud:
    """The cloud of a scene with its south-west corner at (0, 0) and its true terrain."""
    cloud = scene.load()
    if cloud.truth is not None:
        return cloud
    low = np.append(np.floor(cloud.xyz[:, :2].min(axis=0)), 0.0)
    xyz = cloud.xyz - low
    ground = xyz[cloud.classification == GROUND]
    _, first = np.unique(ground[:, :2], axis=0, return_index=True)
    return Cloud(
        xyz, cloud.classification, cloud.rgb, cloud.returns, partial(_tin, ground[first])
    )


def _tin(ground: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Heights between the true ground points, NaN farther than `KNOWN_M` from all of them."""
    heights = LinearNDInterpolator(ground[:, :2], ground[:, 2])(x, y)
    away, _ = KDTree(ground[:, :2]).query(np.stack((x, y), axis=-1))
    return np.where(away <= KNOWN_M, heights, np.nan)


def written(cloud: Cloud, path: Path) -> Path:
    """The cloud as a file without classes."""
    coloured = cloud.rgb is not None
    header = laspy.LasHeader(point_format=7 if coloured else 6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.array([*CORNER, 0.0])
    header.add_crs(CRS.from_epsg(25832))
    las = laspy.LasData(header)
    las.x, las.y = (cloud.xyz[:, axis] + CORNER[axis] for axis in (0, 1))
    las.z = cloud.xyz[:, 2]
    ones = np.ones((len(cloud.xyz), 2), np.uint8)
    returns = ones if cloud.returns is None else cloud.returns
    las.return_number, las.number_of_returns = returns[:, 0], returns[:, 1]
    if coloured:
        las.red, las.green, las.blue = cloud.rgb.T
    path.parent.mkdir(parents=True, exist_ok=True)
    las.write(path)
    return path


def ran(known: Known, folder: Path) -> Path:
    """OUT of a run of a scene up to its rasters; it resumes."""
    out, cloud = folder / known.name, folder / "clouds" / f"{known.name}.laz"
    if not cloud.exists():
        written(placed(known.scene), cloud)
    settings = {
        "products": "dtm,mask", "kind": known.kind, "keep_classes": "none", "workers": 1, "in_process": True,
        "crs": "EPSG:25832",
    }  # fmt: skip
    run([str(cloud)], out, RunConfig.from_mapping(settings), until="grid")
    return out


@dataclass(frozen=True)
class Pixels:
    """Pixels with a height and a true one: ``measures`` [6, n] as `Measures`, ``mask`` [n], ``error`` [n] in metres."""

    measures: np.ndarray
    mask: np.ndarray
    error: np.ndarray


def pixels_of(known: Known, out: Path) -> Pixels:
    """What is known of the pixels of a run of a scene, and their errors."""
    store = open_store(str(out / "store.zarr"))
    frame, name = store.meta.frame, "dtm-outlined"
    spec = RasterSpec.from_json(store.get_state(f"raster-{name}"))
    erode = frame.counts(MATCHED_EROSION) if known.kind == "dim" else Fraction(0)
    rule = GroundSelection(
        LABELS, skip_flags=WITHHELD_FLAG | STRAY_FLAG, erode=erode, erode_rise=1000
    )
    truth = placed(known.scene).truth
    measured, masks, errors = [], [], []
    for block in spec.blocks(BLOCK_PIXELS):
        heights = store.read_block(name, block).astype(np.float64)
        x, y = (
            centres / COUNTS_PER_UNIT - corner
            for centres, corner in zip(spec.centres(block), CORNER, strict=True)
        )
        error = np.where(heights == np.float32(NODATA), np.nan, heights) - truth(x, y)
        there = ~np.isnan(error)
        margin = land_margin(float(spec.lattice.size * frame.metres_xy))
        wider = read_cells(store, name, spec, padded(block, margin), NODATA)
        terrain = np.where(wider == np.float32(NODATA), np.nan, wider.astype(np.float64))
        points = PointsNear(store, rule, spec, block)
        found = measures_of(points, terrain, margin, frame.counts(MAX_EDGE_M))
        measured.append(np.stack([values[there] for values in found]))
        masks.append(store.read_block("mask", block)[there])
        errors.append(error[there])
    return Pixels(
        np.concatenate(measured, axis=1), np.concatenate(masks), np.concatenate(errors)
    )
