"""Exceptions of tiler. Each class has an exit code of the command line."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

from tiler.redaction import without_secrets

_NO_SPACE = (errno.ENOSPC, errno.EDQUOT)
_NEXT_TO_NOTHING_BYTES = 1 << 20
_MAX_WINDOWS_PATH = 259
"""Length of the longest path on Windows while its setting for long paths is off, as it is at first."""
_PARTIAL = ".tiler-.partial"
"""Prefix and suffix that `tiler.io.atomic_files.partial_path` adds to the name of a file."""
_IN_USE = (5, 32)
"""Numbers of the Windows errors for a file that another process has open."""


def first_line(error: BaseException) -> str:
    """Return the first line of an error's text, since libraries write several lines, or its name if it has no text."""
    return (str(error) or repr(error)).splitlines()[0]


class TilerError(Exception):
    """Error of tiler. The message is one line: where, what is wrong, value, remedy."""

    exit_code = 4
    again = False
    """Whether a task that ended with this error may be retried, since the cause may be
    temporary."""

    def __init__(self, *parts: object) -> None:
        # Messages contain URLs, and are sent to terminals, files and other machines. So secrets
        # are removed here.
        super().__init__(
            *(without_secrets(part) if isinstance(part, str) else part for part in parts)
        )


def exit_code_of(error: BaseException) -> int:
    """Return the exit code of a command that ends with an error or an interruption."""
    if isinstance(error, TilerError):
        return error.exit_code
    return 130 if isinstance(error, KeyboardInterrupt) else TilerError.exit_code


class ConfigError(TilerError):
    """Wrong usage or configuration, or a plan that cannot work."""

    exit_code = 2


class LockedError(ConfigError):
    """Another run holds the store or the folder of results."""


class StoreError(TilerError):
    """A store is damaged, or another version or program wrote it."""


class ForeignStoreError(StoreError):
    """There is no store of this version at the given location. The user has to change the command."""

    exit_code = 2


class CorruptStoreError(StoreError):
    """Objects of a store are damaged or missing. A run repeats the tasks that wrote them.

    Attributes
    ----------
    keys : tuple of str
        Keys of the objects.
    """

    def __init__(self, text: str, keys: tuple[str, ...] = ()) -> None:
        super().__init__(text, keys)
        self.keys = keys

    def __str__(self) -> str:
        return str(self.args[0])


class InputError(TilerError):
    """A source file cannot be read, or its CRS cannot be used."""

    exit_code = 3


class ProcessingError(TilerError):
    """The work itself failed: no tile succeeded, one failed with ``--on-error stop``, or a file cannot be written."""

    again = True


class ConnectionLostError(ProcessingError):
    """The connection to the scheduler of a cluster broke."""


class DiskFullError(ProcessingError):
    """No space or quota is left. The run ends, since every other task would fail as well."""

    again = False


class StoreAccessError(ProcessingError):
    """The store does not accept writes. The cause is not an input or a tile, so the run ends if all retries fail."""


def is_in_use(error: Exception) -> bool:
    """Return whether Windows refused to change a file because another process has it open."""
    return getattr(error, "winerror", None) in _IN_USE  # Other systems do not set the number.


def write_error(what: str, error: Exception, folder: Path | None = None) -> ProcessingError:
    """Return the one-line error for a write that the file system refused.

    The error is a `DiskFullError` if no space is left.

    Parameters
    ----------
    what : str
        Name of the file or object that could not be written.
    error : Exception
        OSError, or an error of a library, which does not contain the reason.
    folder : Path, optional
        Folder of the file. If the error does not contain the reason, the free space of this folder is checked.
    """
    number = getattr(error, "errno", None)
    full = number in _NO_SPACE
    if not number and folder is not None and folder.exists():
        full = shutil.disk_usage(folder).free < _NEXT_TO_NOTHING_BYTES
    reason = os.strerror(number) if number else " ".join(str(error).split())
    if full:
        return DiskFullError(
            f"{what}: cannot be written ({reason}): the disk is full; free some space and run again"
        )
    if is_in_use(error):
        return ProcessingError(
            f"{what}: cannot be written ({reason}): another program has it open, or it is protected; close it there, "
            "check permissions, then run again"
        )
    # Libraries do not name the file that they write, which has a longer name until it is complete.
    written = getattr(error, "filename", None) or f"{what}{_PARTIAL}"
    if os.name == "nt" and len(os.path.abspath(written)) > _MAX_WINDOWS_PATH:
        return ProcessingError(
            f"{what}: cannot be written ({reason}): the path of its temporary file has more than "
            f"{_MAX_WINDOWS_PATH} characters; use a shorter one, or enable long paths in Windows, then run again"
        )
    return ProcessingError(
        f"{what}: cannot be written ({reason}); check free space and permissions, then run again"
    )
