"""Compiling numeric functions (kernels) with numba, and the folder where their machine code is kept.

Kernels compile once per machine and version. The name of the folder contains a digest of the
location and of all sources of the package. Without this digest, old code could be used after an
upgrade: numba checks only the source file of a kernel, not the sources of the kernels that it
calls.

The folder is in ``NUMBA_CACHE_DIR`` if that is set, otherwise in the user's cache folder, or in
a folder of the user among the temporary files. If none of these can be written, each process
compiles for itself. If one of them has code that only root can have written, such as code in a
container image, the code is copied to the folder of the user.
"""

import functools
import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, ParamSpec, SupportsInt, TypeVar, cast

import numba
import numpy as np
from numba.core import config as numba_config

__all__ = ["as_int64", "cache_folder", "compiled_count", "inlined", "kernel"]

# The variables of this module are made at run time, so they have no types.
config: Any = numba_config
# numba would read a file of settings in the current folder. A file next to the clouds must not
# change results.
config._config_fname = os.devnull
config.reload_config()

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")


@functools.cache
def cache_folder() -> Path | None:
    """Return the folder of the machine code of this version, or None if no folder can be written."""
    package = Path(__file__).resolve().parent
    # numba separates installations by location. Without the location in the digest, a second
    # installation would share this folder but could not use its code.
    digest = hashlib.blake2b(f"{numba.__version__} {package}".encode(), digest_size=8)
    for path in sorted(package.rglob("*.py")):
        digest.update(path.read_bytes())
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    user = "user"
    if hasattr(os, "getuid"):
        user = str(os.getuid())
    parents = (
        os.environ.get("NUMBA_CACHE_DIR"),
        home,
        os.path.join(tempfile.gettempdir(), f"cache-{user}"),
    )
    folders = [
        Path(parent) / "tiler-kernels" / digest.hexdigest() for parent in parents if parent
    ]
    shared = [folder for folder in folders if _trusted(folder)]
    for folder in folders:
        if shared and not folder.exists():
            _copy_cache(shared[0], folder)
        if _usable(folder):
            return folder
    return None


def compiled_count() -> int:
    """Return the number of compiled kernels in the folder of this version."""
    folder = cache_folder()
    if folder is None:
        return 0
    return sum(1 for _ in folder.rglob("*.nbc"))


_ROOT = 0


def _trusted(path: Path) -> bool:
    """Return whether only root can change a path: root owns it and its parents, and only root can write them."""
    try:
        real = path.resolve(strict=True)
        stats = [part.stat() for part in (real, *real.parents)]
    except OSError:
        return False
    return all(
        s.st_uid == _ROOT and not s.st_mode & (stat.S_IWGRP | stat.S_IWOTH) for s in stats
    )


def _copy_cache(shared: Path, folder: Path) -> None:
    """Copy a cache completely or not at all, even if other processes copy it at the same time."""
    with suppress(OSError):
        folder.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent) as scratch:
            copy = Path(scratch) / "copy"
            shutil.copytree(shared, copy, symlinks=True, ignore=_untrusted)
            copy.chmod(0o700)
            copy.rename(folder)


def _untrusted(folder: str, names: list[str]) -> list[str]:
    return [name for name in names if not _trusted(Path(folder, name))]


def _usable(folder: Path) -> bool:
    """Return whether a folder belongs to the user and can be written. Make the folder if it does not exist."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        is_own = not hasattr(os, "getuid") or folder.stat().st_uid == os.getuid()
    except OSError:
        return False
    return is_own and os.access(folder, os.W_OK)


def kernel(function: Callable[_Parameters, _Result]) -> Callable[_Parameters, _Result]:
    """Compile `function` to machine code on its first call. The code is cached on disk and runs without the GIL.

    Neither ``fastmath`` nor ``parallel`` is used, because sums and comparisons must give the
    same bits in each run. Tiles run in parallel instead.

    Parameters
    ----------
    function : callable
        A function in the subset of Python that numba compiles in nopython mode.

    Returns
    -------
    callable
        The compiled function, with the same signature for the type checker.
    """
    folder, previous = cache_folder(), config.CACHE_DIR
    try:
        config.CACHE_DIR = str(folder or "")
        compiled = numba.njit(cache=folder is not None, nogil=True)(function)
    finally:
        config.CACHE_DIR = previous  # Other packages keep their own folder.
    return cast(Callable[_Parameters, _Result], compiled)


def inlined(function: Callable[_Parameters, _Result]) -> Callable[_Parameters, _Result]:
    """Compile `function` as a kernel that is inlined where it is called.

    It is for short kernels that are passed tables of arrays in inner loops. A normal call
    counts references to each array of a table, which takes longer than the kernel itself.
    """
    return cast(
        Callable[_Parameters, _Result], numba.njit(nogil=True, inline="always")(function)
    )


@kernel
def as_int64(value: SupportsInt) -> int:
    """Convert a value to int64. Kernels are then not compiled a second time for int32."""
    return np.int64(value)  # type: ignore[return-value]
