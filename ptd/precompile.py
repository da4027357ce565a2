"""Compilation of kernels before workers start. Otherwise each worker would compile the kernels.

`ptd.kernel` describes the folder of the machine code. An empty file in this folder, called a mark, shows that all
kernels of a method or of an interpolation are compiled.
"""

from __future__ import annotations

import functools
import gc
from collections.abc import Callable
from fractions import Fraction
from typing import Literal

import numpy as np

from ptd.arrays import Float64, UInt16
from ptd.frame import Scale, Window
from ptd.kernel import cache_folder

GARBAGE_OBJECTS = 100_000
"""Garbage is collected after this many new objects. With Python's default of 700, collection
takes a tenth of the compilation time."""


def _scene() -> tuple[Float64, UInt16]:
    """Return a coloured town on which every method works: xyz [n, 3] in metres, rgb [n, 3].

    It covers 60 m of a slope at 10 points/m2 with noise of 5 cm, with a mound, four houses with
    a facade each, trees, and low outliers.
    """
    random = np.random.default_rng(1)
    x, y = 60 * random.random((2, 36_000))
    u, v = x % 30 - 15, y % 30 - 15
    tree = np.hypot(u - 11, v + 11) < 3
    mound = 1.5 * np.exp(-((x - 30) ** 2 + (y - 30) ** 2) / 50)
    z = 0.04 * x + mound + tree * random.uniform(2, 6, x.size)
    z[(abs(u) < 7) & (abs(v) < 5)] = 13.0
    z[::5000] -= 20.0
    rows = np.flatnonzero(abs(u) < 7)
    facades = np.stack([x[rows], y[rows] // 30 * 30 + 10, random.uniform(4, 13, rows.size)])
    xyz = np.concatenate([[x, y, z + random.normal(0, 0.05, x.size)], facades], axis=1)
    green = np.append(tree, np.zeros(rows.size, np.bool_))
    rgb = np.where(green, [[90], [140], [60]], [[120], [118], [116]])
    rgb += random.integers(-9, 9, rgb.shape)
    return xyz.T, rgb.T.astype(np.uint16)


def has_kinds(method: str) -> bool:
    """Return whether a method has different passes, and so different kernels, for LiDAR and photogrammetric clouds.

    Such passes override `Pass.applies`.
    """
    from ptd.methods import METHODS
    from ptd.passes import Pass

    return any(
        type(step).applies is not Pass.applies for step in METHODS[method].params().passes
    )


def warm_filters(method: str, notify: Callable[[], None], kind: str | None = None) -> None:
    """Compile the kernels of a method if necessary.

    Parameters
    ----------
    method : str
    notify : callable
        Function that is called before the compilation, because the compilation takes long.
    kind : {"lidar", "dim"} or None
        Kind of the cloud, if the method has passes for only one kind. None: both kinds.
    """
    from ptd.api import do_passes
    from ptd.methods import METHODS
    from ptd.passes import KINDS, RunHints

    def run_passes(cloud_kind: str | None) -> None:
        xyz, rgb = _scene()
        counts = np.ascontiguousarray((1000 * xyz).T.astype(np.int32))
        # Multiple returns show that the cloud is LiDAR. `RunHints` does not give the kind, so
        # the passes that decide the kind are compiled as well.
        returns = np.ones((2, len(xyz)), np.uint8)
        if cloud_kind == KINDS[0]:
            returns += 1
        columns = {"rgb": np.ascontiguousarray(rgb.T), "returns": returns}
        # With closed sides, kernels for certificates compile too.
        tile = Window(0, 0, 60_000, 60_000)
        do_passes(METHODS[method].params(), counts, columns, Scale(), tile, RunHints())

    kinds: tuple[str | None, ...] = (None,)
    if has_kinds(method):
        kinds = (kind,) if kind else KINDS
    for cloud_kind in kinds:
        compile_once(
            filters_name(method, cloud_kind), notify, functools.partial(run_passes, cloud_kind)
        )


def warm_last_pass() -> None:
    """Compile the kernels of the last pass of ``auto`` for laser scans.

    A second process does so while the first one compiles those of earlier passes (`warm_filters`).
    """
    from ptd.ground.labelling import GROUND
    from ptd.methods.auto.method import Auto, LabelPass
    from ptd.passes import Points
    from ptd.places import PLACES

    xyz = np.ascontiguousarray((1000 * _scene()[0]).T.astype(np.int32))
    points = Points(xyz, np.full(xyz.shape[1], GROUND, np.uint8))
    tile, state = Window(0, 0, 60_000, 60_000), {"run": {"sigma_m": None}, PLACES: {}}
    LabelPass(Auto()).fit(points, tile, tile, Scale(), state).label(points)


def filters_name(method: str, kind: str | None) -> str:
    """Return the name of the mark for the kernels of a method, and of a kind if kinds have different kernels."""
    if kind and has_kinds(method):
        return f"{method}-{kind}"
    return method


def gridding_name(interpolation: str) -> str:
    """Return the name of the mark for the kernels of gridding."""
    return f"gridding-{interpolation}"


def is_compiled(name: str) -> bool:
    """Return whether the kernels with the mark ``name`` are compiled, or no folder can store them."""
    folder = cache_folder()
    return folder is None or (folder / f"{name}.compiled").exists()


def why_not_compiled(name: str) -> str:
    """Return a text that explains why the kernels with the mark ``name`` are not compiled yet."""
    folder = cache_folder()
    if folder is None:
        return "no folder for machine code is safe and can be written, so each process compiles for itself"
    if any(folder.glob("*.compiled")):
        return f"those of {name} have not been compiled here yet; each method and kind of cloud has its own"
    if any(other != folder for other in folder.parent.iterdir()):
        return (
            f"those in {folder.parent} are of another version or installation of tiler or numba"
        )
    return f"the first run that keeps its machine code in {folder.parent}"


def warm_gridding(
    interpolation: Literal["linear", "natural"], notify: Callable[[], None]
) -> None:
    """Compile the kernels of gridding if necessary, after a call of ``notify``."""
    from ptd.gridding import above_ground, ground_cells, nearest
    from ptd.tin import KnownWindow, Pixels, Tin, rasterise

    def make_rasters() -> None:
        pixels = Pixels(1000, 1, 0, 59, 60, 60)
        xyz = np.ascontiguousarray((1000 * _scene()[0]).T.astype(np.int32))
        tin = Tin.build(*xyz)
        window = KnownWindow(-1000, -1000, 61_000, 61_000)
        rasterise(
            tin, pixels, interpolator=interpolation, max_edge=5e4, max_radius=5e4, window=window
        )
        nearest.nearest_points(xyz[0], xyz[1], xyz[2], pixels, 1, 5e3)
        cells = ground_cells.CellWindow(1000, 1, 0, 59, 60, 60)
        highest = above_ground.HighestReturns(cells, np.full(60 * 60, np.inf))
        highest.add(xyz, np.ones(xyz.shape[1], np.bool_))
        above_ground.near_objects(xyz, xyz, Fraction(1000), 1000, (0, 0))
        ground_cells.plane_variance(xyz, cells, (2, 5))
        ground_cells.cell_counts(xyz, cells)
        ground_cells.cell_numbers(xyz, cells)

    compile_once(gridding_name(interpolation), notify, make_rasters)


def compile_once(
    name: str, notify: Callable[[], None], run_kernels: Callable[[], None]
) -> None:
    """Compile kernels by running them, unless the mark ``name`` next to the machine code exists."""
    folder = cache_folder()
    if folder is None:
        notify()  # Every process compiles for itself.
        return
    mark = folder / f"{name}.compiled"
    if mark.exists():
        return
    notify()
    threshold = gc.get_threshold()
    gc.set_threshold(GARBAGE_OBJECTS)
    try:
        run_kernels()
    finally:
        gc.set_threshold(*threshold)
    mark.touch()
