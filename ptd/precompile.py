"""Compile the kernels once per machine, before workers start that would each compile them.

Where their machine code is kept: `ptd.kernel`. A file beside it says that a method's kernels are among it.
"""

from __future__ import annotations

import functools
import gc
from collections.abc import Callable
from fractions import Fraction
from typing import Literal

import numpy as np
import numpy.typing as npt

from ptd.frame import Scale, Window
from ptd.kernel import cache_folder

Float64 = npt.NDArray[np.float64]

GARBAGE_OBJECTS = 100_000
"""The compiler makes objects by the million: looking for garbage after each 700 of them is a tenth of its time."""


def _scene() -> tuple[Float64, npt.NDArray[np.uint16]]:
    """A coloured town in which every method finds what it needs: xyz [n, 3] in metres, rgb [n, 3].

    60 m on a slope, 10 points/m2 with noise of 5 cm, a mound, four houses with a facade each, trees, low outliers.
    """
    random = np.random.default_rng(1)
    x, y = 60 * random.random((2, 36_000))
    u, v = x % 30 - 15, y % 30 - 15
    tree = np.hypot(u - 11, v + 11) < 3
    mound = 1.5 * np.exp(-((x - 30) ** 2 + (y - 30) ** 2) / 50)
    z = 0.04 * x + mound + tree * random.uniform(2, 6, x.size)
    z[(abs(u) < 7) & (abs(v) < 5)] = 13.0
    z[::5000] -= 20.0
    at = np.flatnonzero(abs(u) < 7)
    facades = np.stack([x[at], y[at] // 30 * 30 + 10, random.uniform(4, 13, at.size)])
    xyz = np.concatenate([[x, y, z + random.normal(0, 0.05, x.size)], facades], axis=1)
    green = np.append(tree, np.zeros(at.size, np.bool_))
    rgb = np.where(green, [[90], [140], [60]], [[120], [118], [116]])
    rgb += random.integers(-9, 9, rgb.shape)
    return xyz.T, rgb.T.astype(np.uint16)


def has_kinds(method: str) -> bool:
    """Whether a method has passes that do not always apply: those for one kind of clouds have kernels of their own."""
    from ptd.methods import METHODS
    from ptd.passes import Pass

    return any(type(step).applies is not Pass.applies for step in METHODS[method].params().passes)


def warm_filters(method: str, tell: Callable[[], None], kind: str | None = None) -> None:
    """Compile what a method uses, unless that was done; ``tell`` is called before it takes long.

    Parameters
    ----------
    method : str
    tell : callable
    kind : {"lidar", "dim"} or None
        Of the cloud, where the method has passes for one kind; None: what both need.
    """
    from ptd.api import do_passes
    from ptd.methods import METHODS
    from ptd.passes import KINDS, RunFacts

    def work(which: str | None) -> None:
        xyz, rgb = _scene()
        counts = np.ascontiguousarray((1000 * xyz).T.astype(np.int32))
        # Several returns are a laser scan's: the kind is not said, so that what decides it is compiled as well.
        returns = np.full((2, len(xyz)), 2 if which == KINDS[0] else 1, np.uint8)
        columns = {"rgb": np.ascontiguousarray(rgb.T), "returns": returns}
        tile = Window(0, 0, 60_000, 60_000)  # points beyond it are in doubt, which has kernels of its own
        do_passes(METHODS[method].params(), counts, columns, Scale(), tile, RunFacts())

    for which in ((kind,) if kind else KINDS) if has_kinds(method) else (None,):
        _once(filters_name(method, which), tell, functools.partial(work, which))


def filters_name(method: str, kind: str | None) -> str:
    """What says of a method's kernels that they are compiled; ``kind`` counts where the method has passes for it."""
    return f"{method}-{kind}" if kind and has_kinds(method) else method


def gridding_name(interpolation: str) -> str:
    """What says of the kernels of gridding that they are compiled."""
    return f"gridding-{interpolation}"


def is_compiled(name: str) -> bool:
    """Whether kernels of that name are compiled, or cannot be ahead, as there is no place for them."""
    folder = cache_folder()
    return folder is None or (folder / f"{name}.compiled").exists()


def warm_gridding(interpolation: Literal["linear", "natural"], tell: Callable[[], None]) -> None:
    """Compile what gridding uses, unless that was done; ``tell`` is called before it takes long."""
    from ptd.gridding import highest_returns, nearest, wall_feet
    from ptd.tin import Pixels, Tin, rasterise
    from ptd.tin import Window as Seen

    def work() -> None:
        pixels = Pixels(1000, 1, 0, 59, 60, 60)
        xyz = np.ascontiguousarray((1000 * _scene()[0]).T.astype(np.int32))
        tin, window = Tin.build(*xyz), Seen(-1000, -1000, 61_000, 61_000)
        rasterise(tin, pixels, interpolator=interpolation, max_edge=5e4, max_radius=5e4, window=window)
        nearest.nearest_points(xyz[0], xyz[1], xyz[2], pixels, 1, 5e3)
        highest_returns.HighestReturns(1, 1).add(np.zeros(xyz.shape[1], np.int64), xyz)
        wall_feet.beside_objects(xyz, xyz, Fraction(1000), 1000, (0, 0))

    _once(gridding_name(interpolation), tell, work)


def _once(name: str, tell: Callable[[], None], work: Callable[[], None]) -> None:
    """Compile by doing some work, unless a file beside the machine code says that this was done."""
    folder = cache_folder()
    done = None if folder is None else folder / f"{name}.compiled"
    if done is None:
        tell()  # every process compiles for itself
    elif not done.exists():
        tell()
        often = gc.get_threshold()
        gc.set_threshold(GARBAGE_OBJECTS)
        try:
            work()
        finally:
            gc.set_threshold(*often)
        done.touch()
