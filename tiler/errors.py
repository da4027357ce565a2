"""The exception tree; each class knows the exit code of the command line."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

from tiler.redaction import without_secrets

_NO_SPACE = (errno.ENOSPC, errno.EDQUOT)
_NEXT_TO_NOTHING_BYTES = 1 << 20


def first_line(error: BaseException) -> str:
    """The first line of an error's text, or the error's name if it has no text. Libraries write several lines."""
    return (str(error) or repr(error)).splitlines()[0]


class TilerError(Exception):
    """Something that tiler refuses or cannot do; the message is one line: what, where, value, remedy."""

    exit_code = 4
    again = False
    """Whether a task that ended with this error may be tried again, as the cause may be temporary."""

    def __init__(self, *parts: object) -> None:
        # Messages name URLs, and reach terminals, files and other machines. All of them pass here.
        super().__init__(*(without_secrets(part) if isinstance(part, str) else part for part in parts))


def exit_code_of(error: BaseException) -> int:
    """The exit code of a command that ends with an error or an interruption."""
    if isinstance(error, TilerError):
        return error.exit_code
    return 130 if isinstance(error, KeyboardInterrupt) else TilerError.exit_code


class ConfigError(TilerError):
    """Wrong usage or configuration, or a plan that cannot work."""

    exit_code = 2


class LockedError(ConfigError):
    """Another run holds the store."""


class StoreError(TilerError):
    """A store is damaged, or another version or program wrote it."""


class ForeignStoreError(StoreError):
    """There is no store of this version at the given place; the user has to name another place."""

    exit_code = 2


class DamagedError(StoreError):
    """Objects of a store are damaged or missing; a run repeats the tasks that wrote them.

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
    """The work itself failed: no tile succeeded, or one failed with ``--on-error stop``."""

    again = True


class ConnectionLostError(ProcessingError):
    """The connection to the scheduler of a cluster broke."""


class DiskFullError(ProcessingError):
    """No space or quota is left. The run ends, since every other task would fail as well."""

    again = False


class StoreAccessError(ProcessingError):
    """The store accepts no writes. No input or tile is the cause, so the run ends once repeated tries failed."""


def refused_write(what: str, error: Exception, folder: Path | None = None) -> ProcessingError:
    """The one-line error for a write that the file system refused; a `DiskFullError` if no space is left.

    Parameters
    ----------
    what : str
        Name of the file or object that could not be written.
    error : Exception
        An OSError, or an error of a library, which does not say why it could not write.
    folder : Path, optional
        Folder of the file. If a library gives no reason, the free space of the folder does.
    """
    number = getattr(error, "errno", None)
    full = number in _NO_SPACE
    if not number and folder is not None and folder.exists():
        full = shutil.disk_usage(folder).free < _NEXT_TO_NOTHING_BYTES
    reason = os.strerror(number) if number else " ".join(str(error).split())
    if full:
        return DiskFullError(
            f"{what}: cannot be written ({reason}): the disk is full; free some and run again"
        )
    return ProcessingError(
        f"{what}: cannot be written ({reason}); check free space and permissions, then run again"
    )
