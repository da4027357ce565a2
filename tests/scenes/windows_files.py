"""A Python in which files behave as on Windows, and tiler's modules find nothing that POSIX alone has.

Put the text of this file into a folder of ``PYTHONPATH`` as ``sitecustomize.py``, and that of
`bare_system` beside it under its own name. It holds for Python's functions for files, not for
libraries in C, and sees the processes of its own session (`setsid`):

- A file that a process has open, or mapped, can be neither replaced, renamed nor removed; nor
  can a folder above it.
- Names are found whatever their case. Names that Windows refuses, and paths of more than 259
  characters, are refused.
- `os.rename` replaces nothing; `os.fsync` wants a file that is open for writing; folders cannot
  be opened.
- A text file that tiler opens has to name its encoding, as the default is a code page.
"""

from __future__ import annotations

import builtins
import errno
import fcntl
import io
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from typing import Any

OWN = ("tiler", "ptd", "cli")
IN_USE, NOT_THERE, EXISTS, BAD_NAME = 32, 3, 183, 123
"""Numbers of Windows' errors."""
MAX_PATH_LENGTH = 259
ILLEGAL = re.compile(r'[<>:"|?*\\\x00-\x1f]|[ .]$')
DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
POSIX_ALONE = ("/proc", "/dev", "/sys")
"""Folders that tiler does not find, and libraries do,"""
SCRATCH = tempfile.gettempdir() + os.sep
"""but for this one, if the tests write to memory."""

FUNCTIONS = """access chmod fsync listdir lstat mkdir open readlink remove rename replace rmdir scandir stat truncate
    unlink utime"""
real: dict[str, Callable[..., Any]] = {name: getattr(os, name) for name in FUNCTIONS.split()}
real_open, real_path = io.open, os.path.realpath


def refusal(kind: type[OSError], number: int, winerror: int, path: str) -> OSError:
    error = kind(number, f"{os.strerror(number)} [WinError {winerror}]", path)
    error.winerror = winerror  # type: ignore[attr-defined]
    return error


def is_there(path: str) -> bool:
    try:
        real["lstat"](path)
    except OSError:
        return False
    return True


def on_posix_alone(path: str) -> bool:
    return path.startswith(POSIX_ALONE) and not path.startswith(SCRATCH)


def as_stored(path: Any) -> Any:
    """A path with the case of the names that are there."""
    if isinstance(path, os.PathLike):
        path = os.fspath(path)
    if not isinstance(path, str) or not path or on_posix_alone(path) or is_there(path):
        return path
    if len(os.path.abspath(path)) > MAX_PATH_LENGTH:
        raise refusal(FileNotFoundError, errno.ENOENT, NOT_THERE, path)
    folder, name = os.path.split(path)
    if not name or folder == path:
        return path
    folder = as_stored(folder)
    try:
        names = real["listdir"](folder or ".")
    except OSError:
        return path
    for there in names:
        if there.casefold() == name.casefold():
            return os.path.join(folder, there)
    return os.path.join(folder, name)


def new_name(path: Any) -> Any:
    """`as_stored` of a path that may come to be, whose name Windows has to accept."""
    path = as_stored(path)
    if isinstance(path, str) and not on_posix_alone(path):
        name = os.path.basename(path)
        if ILLEGAL.search(name) or DEVICES.fullmatch(name):
            raise refusal(OSError, errno.EINVAL, BAD_NAME, path)
    return path


def processes() -> Iterator[str]:
    """Numbers of the processes that belong to the session of the tests, as text."""
    session = os.getsid(0)
    for name in real["listdir"]("/proc"):
        try:
            if name.isdigit() and os.getsid(int(name)) == session:
                yield name
        except OSError:
            continue


def opened(process: str) -> Iterator[str]:
    """The paths that a process has open or mapped."""
    folder = f"/proc/{process}/fd"
    for number in real["listdir"](folder):
        try:
            yield real["readlink"](f"{folder}/{number}")
        except OSError:
            continue
    with real_open(f"/proc/{process}/maps", encoding="utf-8", errors="replace") as maps:
        for line in maps:
            yield line.rstrip("\n").partition("/")[2].join(("/", ""))


def refuse_in_use(path: str) -> None:
    whole = real_path(path)
    for process in processes():
        try:
            found = set(opened(process))
        except OSError:
            continue
        if any(place == whole or place.startswith(f"{whole}/") for place in found):
            raise refusal(PermissionError, errno.EACCES, IN_USE, path)


def caller() -> str:
    """The module that called, without those of the standard library that only pass on a call."""
    frame: Any = sys._getframe(2)
    while frame is not None and frame.f_globals.get("__name__") in (
        __name__,
        "pathlib",
        "tempfile",
    ):
        frame = frame.f_back
    name = "" if frame is None else frame.f_globals.get("__name__", "")
    if name == "__main__":
        name = getattr(frame.f_globals.get("__spec__"), "name", "")
    return str(name)


def is_own(module: str) -> bool:
    return module.partition(".")[0] in OWN


def hide(path: Any) -> None:
    """Let a folder be missing that POSIX alone has."""
    if on_posix_alone(str(path)) and str(path) != os.devnull:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))


def open_file(file: Any, mode: str = "r", *rest: Any, **options: Any) -> Any:
    encoding = rest[1] if len(rest) > 1 else options.get("encoding")
    if is_own(caller()):
        hide(file)
        if "b" not in mode and encoding in (None, "locale"):
            raise ValueError(f"{file}: opened as text without an encoding")
    path = as_stored(file) if mode[0] == "r" else new_name(file)
    return real_open(path, mode, *rest, **options)


def open_number(path: Any, flags: int, *rest: Any, **options: Any) -> int:
    path = new_name(path) if flags & os.O_CREAT else as_stored(path)
    if is_own(caller()) and os.path.isdir(path):
        raise refusal(PermissionError, errno.EACCES, 5, path)
    return int(real["open"](path, flags, *rest, **options))


def sync(file: Any) -> None:
    number = file if isinstance(file, int) else file.fileno()
    if fcntl.fcntl(number, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
        raise OSError(errno.EBADF, os.strerror(errno.EBADF))
    real["fsync"](number)


def replace(source: Any, target: Any) -> None:
    source, target = as_stored(source), new_name(target)
    refuse_in_use(source)
    if is_there(target):
        refuse_in_use(target)
        if os.path.isdir(target):
            raise refusal(PermissionError, errno.EACCES, 5, target)
    real["replace"](source, target)


def rename(source: Any, target: Any) -> None:
    target = new_name(target)
    if is_there(target) and as_stored(source) != target:
        raise refusal(FileExistsError, errno.EEXIST, EXISTS, target)
    replace(source, target)


def removing(name: str) -> Callable[..., None]:
    def remove(path: Any) -> None:
        path = as_stored(path)
        if is_there(path):
            refuse_in_use(path)
        real[name](path)

    return remove


def whole_path(path: Any, **options: Any) -> Any:
    return real_path(as_stored(path), **options)


def finding(name: str, find: Callable[[Any], Any]) -> Callable[..., Any]:
    """A function of `os` whose path is found first."""

    def call(path: Any = ".", *rest: Any, **options: Any) -> Any:
        if options.get("dir_fd") is None and not isinstance(path, int):
            if is_own(caller()):
                hide(path)
            path = find(path)
        return real[name](path, *rest, **options)

    return call


def install() -> None:
    """Put these functions in the place of Python's own."""
    builtins.open = io.open = open_file
    for name in ("access", "chmod", "listdir", "lstat", "scandir", "stat", "truncate", "utime"):
        setattr(os, name, finding(name, as_stored))
    os.mkdir = finding("mkdir", new_name)
    for name in ("remove", "rmdir", "unlink"):
        setattr(os, name, removing(name))
    os.open, os.fsync, os.replace, os.rename = open_number, sync, replace, rename  # type: ignore[assignment]
    os.path.realpath = whole_path
    shutil._use_fd_functions = False  # type: ignore[attr-defined]
    tempfile.TemporaryFile = tempfile.NamedTemporaryFile  # type: ignore[assignment]


if __name__ == "sitecustomize":
    install()
    import bare_system  # noqa: F401 - takes `os` as it is now
