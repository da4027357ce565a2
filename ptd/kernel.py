"""Compiling numeric functions (kernels) with numba, and the folder where their machine code is kept.

Kernels compile once per machine and version. The name of the folder contains a digest of the
location and of all sources of the package. Without this digest, old code could be used after an
upgrade: numba checks only the source file of a kernel, not the sources of the kernels that it
calls.

A file of the cache that cannot be read, for example after a power cut, is ignored. Its kernel is
compiled again and replaces the file. So the files have checksums.

The folder is in ``NUMBA_CACHE_DIR`` if that is set, otherwise in the user's cache folder, or in
a folder of the user among the temporary files. If none of these can be written, each process
compiles for itself. If one of them has code that only root can have written, such as code in a
container image, the code is copied to the folder of the user.

Code in the folder runs with the rights of the user. So the folder, all folders above it and all
its files must belong to the user or to root, and other users must not be able to write them. Windows
does not tell Python who may write, so there nothing is checked and no code is copied. The folder is
private there as long as it is in the user's profile, where both default folders are.
"""

import functools
import hashlib
import io
import os
import shlex
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, ParamSpec, SupportsInt, TypeVar, cast

import numba
import numpy as np
from numba.core import caching as numba_caching
from numba.core import config as numba_config

__all__ = [
    "as_int64",
    "cache_folder",
    "cache_refusal",
    "compiled_count",
    "discard_damaged",
    "inlined",
    "kernel",
]

# The variables of this module are made at run time, so they have no types.
config: Any = numba_config
# The functions of this module have no types.
caching: Any = numba_caching
# numba would read a file of settings in the current folder. A file next to the clouds must not
# change results.
config._config_fname = os.devnull
config.reload_config()

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")


@functools.cache
def cache_folder() -> Path | None:
    """Return the folder of the machine code of this version, or None if no folder is safe and can be written."""
    package = Path(__file__).resolve().parent
    # numba separates installations by location. Without the location in the digest, a second
    # installation would share this folder but could not use its code.
    digest = hashlib.blake2b(f"{numba.__version__} {package}".encode(), digest_size=8)
    for path in sorted(package.rglob("*.py")):
        digest.update(path.read_bytes())
    folders = [parent / "tiler-kernels" / digest.hexdigest() for parent in _parents()]
    shared = [folder for folder in folders if _trusted(folder)]
    for folder in folders:
        if shared and not os.path.exists(folder) and _refusal(folder) is None:
            _copy_cache(shared[0], folder)
        if _usable(folder):
            return folder
    return None


def cache_refusal() -> str | None:
    """Return why a preferred folder of machine code is not used, with a remedy, or None.

    Folders that this user cannot write are skipped without a reason.
    """
    used = cache_folder()
    for parent in _parents():
        if used is not None and used.is_relative_to(parent):
            return None
        # The name of the folder is the same in all parents, and no folder is used without one.
        folder = parent / "tiler-kernels" / (used.name if used is not None else "")
        refusal = _refusal(folder)
        if refusal is not None and _can_write(folder):
            return refusal
    return None


def _parents() -> list[Path]:
    """Return the folders that may contain the cache, the preferred one first."""
    user = str(os.getuid()) if hasattr(os, "getuid") else "user"
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    parents = (
        os.environ.get("NUMBA_CACHE_DIR"),
        # A user without an entry in the system and without HOME has no home folder.
        None if home.startswith("~") else home,
        os.path.join(tempfile.gettempdir(), f"cache-{user}"),
    )
    return [Path(os.path.abspath(parent)) for parent in parents if parent]


def compiled_count() -> int:
    """Return the number of compiled kernels in the folder of this version."""
    folder = cache_folder()
    if folder is None:
        return 0
    return sum(1 for _ in folder.rglob("*.nbc"))


def discard_damaged() -> int:
    """Remove damaged files from the folder of this version, and return their number.

    The marks of `ptd.precompile` are removed as well, since they state that all kernels are
    compiled.
    """
    folder = cache_folder()
    if folder is None:
        return 0
    files = [*folder.rglob("*.nbi"), *folder.rglob("*.nbc")]
    damaged = [file for file in files if not _is_intact(file)]
    for file in damaged + (list(folder.glob("*.compiled")) if damaged else []):
        with suppress(OSError):  # Another process may have removed or replaced it.
            file.unlink()
    return len(damaged)


_CHECKSUM_BYTES = 16


def _checksum(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=_CHECKSUM_BYTES).digest()


def _is_intact(path: str | Path) -> bool:
    """Return whether a file of the cache can be read and ends with the checksum of its content."""
    try:
        content = Path(path).read_bytes()
    except OSError:
        return False
    return content[-_CHECKSUM_BYTES:] == _checksum(content[:-_CHECKSUM_BYTES])


class _CacheFiles(caching.IndexDataCacheFile):  # type: ignore[misc]
    """Files of one kernel, each with a checksum at its end, which unpickling ignores.

    numba itself raises any error of unpickling in each process that calls the kernel.
    """

    def _load_index(self) -> dict[Any, str]:
        if not _is_intact(self._index_path):
            return {}
        try:
            return cast(dict[Any, str], super()._load_index())
        except Exception:  # noqa: BLE001 - Intact files of other software may contain anything.
            return {}

    def _load_data(self, name: str) -> Any:
        if not _is_intact(self._data_path(name)):
            raise FileNotFoundError(name)  # numba then compiles the kernel.
        return super()._load_data(name)

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[io.BytesIO]:
        with super()._open_for_write(filepath) as file:
            content = io.BytesIO()
            yield content
            file.write(content.getvalue() + _checksum(content.getvalue()))


class _KernelCache(caching.FunctionCache):  # type: ignore[misc]
    """Cache of one kernel. A kernel that cannot be read or written is compiled by each process."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = _CacheFiles(
            self.cache_path, self._impl.filename_base, self._impl.locator.get_source_stamp()
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # noqa: BLE001 - As in `_load_index`.
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        # For example, a folder has the name of the file. The compiled kernel works without it.
        with suppress(OSError):
            super().save_overload(sig, data)


_ROOT = 0
_WRITABLE = stat.S_IWGRP | stat.S_IWOTH
_MAX_LINKS = 40


def _trusted(path: Path) -> bool:
    """Return whether only root can change a path: root owns it and its parents, and only root can write them."""
    return hasattr(os, "getuid") and os.path.exists(path) and _open_part(path, {_ROOT}) is None


def _open_part(path: Path, owners: set[int]) -> Path | None:
    """Return the first part of a path that others than the ``owners`` can change, or None.

    A part is a folder, a link or the path itself. Parts that do not exist yet are safe, since
    this process makes them. Others cannot rename entries of a folder with the sticky bit, such as ``/tmp``, unless the
    entries are theirs.
    """
    if not hasattr(os, "getuid"):  # Windows has other rights.
        return None
    here, waiting, n_links = Path(path.anchor), [*reversed(path.parts[1:])], 0
    while True:
        try:
            status = here.lstat()
            if status.st_uid not in owners:
                return here
            if stat.S_ISLNK(status.st_mode):
                n_links += 1
                target = Path(os.readlink(here))
                waiting += reversed(target.parts[1:] if target.is_absolute() else target.parts)
                here = Path(target.anchor) if target.is_absolute() else here.parent
            else:
                is_sticky = status.st_mode & stat.S_ISVTX and waiting
                if status.st_mode & _WRITABLE and not is_sticky:
                    return here
        except OSError:  # The part does not exist, or cannot be used anyway.
            return None
        if not waiting or n_links > _MAX_LINKS:
            return None
        part = waiting.pop()
        here = here.parent if part == ".." else here / part


def _open_entry(folder: Path, owners: set[int]) -> Path | None:
    """Return the first file or folder in a cache that others than the ``owners`` may have written, or None."""
    try:
        is_hidden = not folder.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO)
    except OSError:
        return None
    # Other users do not reach the entries of a hidden folder, which numba makes with any umask.
    forbidden = 0 if is_hidden else _WRITABLE
    for place, folders, files in os.walk(folder):
        for entry in (Path(place, name) for name in (*folders, *files)):
            try:
                status = entry.lstat()
            except FileNotFoundError:  # Another process has just given a file its final name.
                continue
            is_link = stat.S_ISLNK(status.st_mode)
            if is_link or status.st_uid not in owners or status.st_mode & forbidden:
                return entry
    return None


def _refusal(folder: Path) -> str | None:
    """Return why the machine code in a folder may be that of other users, with a remedy, or None."""
    if not hasattr(os, "getuid"):
        return None
    owners = {_ROOT, os.getuid()}
    part = _open_part(folder, owners)
    kept = f"so no compiled kernels are kept in {folder.parent}"
    if part is None:
        entry = _open_entry(folder, owners)
        if entry is None:
            return None
        return f"{entry}: other users can change it, {kept}; delete {folder}, and the next run makes it again"
    own = "set NUMBA_CACHE_DIR to a folder that only you can change"
    owner = part.lstat().st_uid
    if owner not in owners:
        return f"{part}: belongs to another user ({owner}), {kept}; {own}"
    if os.getuid() in (owner, _ROOT):
        own = f"run `chmod go-w {shlex.quote(str(part))}`, or {own}"
    return f"{part}: other users can write to it, {kept}; {own}"


def _can_write(folder: Path) -> bool:
    """Return whether this user can write to a folder, or make it."""
    existing = next(place for place in (folder, *folder.parents) if os.path.lexists(place))
    return os.access(existing, os.W_OK)


def _copy_cache(shared: Path, folder: Path) -> None:
    """Copy a cache completely or not at all, even if other processes copy it at the same time."""
    with suppress(OSError):
        _make_folder(folder.parent)
        with tempfile.TemporaryDirectory(dir=folder.parent) as scratch:
            copy = Path(scratch) / "copy"
            shutil.copytree(shared, copy, symlinks=True, ignore=_untrusted)
            copy.chmod(0o700)
            copy.rename(folder)


def _untrusted(folder: str, names: list[str]) -> list[str]:
    paths = {name: Path(folder, name) for name in names}
    return [n for n, path in paths.items() if path.is_symlink() or not _trusted(path)]


def _make_folder(folder: Path, mode: int = 0o755) -> None:
    """Make a folder and its parents, which other users cannot write for any umask."""
    if not os.path.exists(folder.parent):
        _make_folder(folder.parent)
    folder.mkdir(mode=mode, exist_ok=True)


def _usable(folder: Path) -> bool:
    """Return whether a folder belongs to the user, only the user can write it, and its code is safe.

    Make the folder if it does not exist.
    """
    if _refusal(folder) is not None:
        return False
    try:
        _make_folder(folder, 0o700)
        is_own = not hasattr(os, "getuid") or folder.stat().st_uid == os.getuid()
    except OSError:
        return False
    # Others may have made a parent meanwhile.
    return is_own and os.access(folder, os.W_OK) and _refusal(folder) is None


_OPTIONS: Any = {"nogil": True, "no_cfunc_wrapper": True}
"""Options of all kernels. Code that C calls is not needed, and would take 7 % of the compilation time."""


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
    compiled: Any = numba.njit(**_OPTIONS)(function)
    folder, previous = cache_folder(), config.CACHE_DIR
    if folder is not None:
        # RuntimeError means that no folder at all can be written.
        with suppress(OSError, RuntimeError):
            config.CACHE_DIR = str(folder)
            cache = _KernelCache(function)
            # If this folder cannot be written, numba chooses one next to the source.
            if Path(cache.cache_path).is_relative_to(folder):
                compiled._cache = cache
        config.CACHE_DIR = previous  # Other packages keep their own folder.
    return cast(Callable[_Parameters, _Result], compiled)


def inlined(function: Callable[_Parameters, _Result]) -> Callable[_Parameters, _Result]:
    """Compile `function` as a kernel that is inlined where it is called.

    It is for short kernels that are passed tables of arrays in inner loops. A normal call
    counts references to each array of a table, which takes longer than the kernel itself.
    """
    return cast(
        Callable[_Parameters, _Result], numba.njit(**_OPTIONS, inline="always")(function)
    )


@kernel
def as_int64(value: SupportsInt) -> int:
    """Convert a value to int64. Kernels are then not compiled a second time for int32."""
    return np.int64(value)  # type: ignore[return-value]
