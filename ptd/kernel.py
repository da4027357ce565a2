"""The one place that names the compiler of the numeric kernels."""

from collections.abc import Callable
from typing import ParamSpec, SupportsInt, TypeVar, cast

import numpy as np
from numba import njit

__all__ = ["kernel", "wide"]

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")


def kernel(function: Callable[_Parameters, _Result]) -> Callable[_Parameters, _Result]:
    """Compile `function` to machine code on its first call (cached on disk, without the GIL).

    Neither ``fastmath`` nor ``parallel`` is ever set: sums and comparisons must give the same bits on each
    run, and parallelism is over tiles.

    Parameters
    ----------
    function : callable
        A function in the subset of Python that numba compiles in nopython mode.

    Returns
    -------
    callable
        The compiled function, with the same signature for the type checker.
    """
    return cast(Callable[_Parameters, _Result], njit(cache=True, nogil=True)(function))


@kernel
def wide(value: SupportsInt) -> int:
    """`value` as int64 inside kernels, so that callers of one kernel do not compile it for int32 as well."""
    return np.int64(value)  # type: ignore[return-value]
