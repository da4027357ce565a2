"""Compile the kernels once per machine, before workers start that would each compile them.

numba keeps machine code beside the modules or, where that folder cannot be written, in the user's cache folder
(``NUMBA_CACHE_DIR`` names another). Processors of different kinds and several users each get their own.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np


def _compiled(kernel: Any) -> bool:
    """Whether machine code of a kernel lies in the cache; False where that cannot be told."""
    cache = getattr(kernel, "_cache", None)
    folder = getattr(cache, "cache_path", None)
    if folder is None:
        return False
    name = f"{kernel.py_func.__module__.rsplit('.', 1)[-1]}.{kernel.py_func.__name__}-"
    return any(path.name.startswith(name) for path in Path(folder).glob("*.nbi"))


def _scene() -> np.ndarray[Any, np.dtype[np.float64]]:
    """A few hundred points on a slope with a block on it and a low outlier: every branch is taken."""
    x, y = (axis.ravel().astype(np.float64) for axis in np.meshgrid(np.arange(30), np.arange(30)))
    z = 0.1 * x + 5.0 * ((abs(x - 15) < 4) & (abs(y - 15) < 4))
    z[100] = -20.0
    return np.stack([x, y, z], axis=1)


def warm_filters(tell: Callable[[], None]) -> None:
    """Compile what filters use, unless that was done; ``tell`` is called before it takes long."""
    from ptd import classify, labelling, morphology, roughness

    if not all(
        _compiled(kernel) for kernel in (labelling._label, morphology._slopes, roughness._drop_raised)
    ):
        tell()
        classify(_scene())


def warm_gridding(tell: Callable[[], None]) -> None:
    """Compile what gridding uses, unless that was done; ``tell`` is called before it takes long."""
    from ptd import highest, nearest
    from ptd.tin import Pixels, Tin, Window, raster, rasterise

    if not all(_compiled(kernel) for kernel in (raster.scan, highest._update, nearest._search)):
        tell()
        pixels = Pixels(1000, 1, 0, 29, 30, 30)
        x, y, z = (1000 * _scene().T).astype(np.int32)
        window = Window(-1000, -1000, 31_000, 31_000)
        rasterise(Tin.build(x, y, z), pixels, max_edge=5e4, max_radius=5e4, window=window)
        nearest.nearest_points(x, y, z, pixels, 1, 5e3)
        highest.HighestReturns(1, 1).add(np.zeros(x.size, np.int64), np.stack([x, y, z]))
