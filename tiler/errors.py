"""The one exception tree; each class knows the exit code that the command line ends with."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

from tiler.redaction import without_secrets

_NO_SPACE = (errno.ENOSPC, errno.EDQUOT)
_NEXT_TO_NOTHING_BYTES = 1 << 20


def first_line(error: BaseException) -> str:
    """The first line of an error's text, or what it is where it has none: libraries write several."""
    return (str(error) or repr(error)).splitlines()[0]


class TilerError(Exception):
    """Anything that tiler refuses or cannot do; the message is one line: what, where, value, remedy."""

    exit_code = 4
    again = False
    """A task that ended with it may be tried again: what is wrong could have been passing."""

    def __init__(self, *parts: object) -> None:
        # Messages name URLs, and reach terminals, files and other machines: here is the one place that all pass.
        super().__init__(*(without_secrets(part) if isinstance(part, str) else part for part in parts))


class ConfigError(TilerError):
    """Usage, configuration, or a plan that cannot work."""

    exit_code = 2


class LockedError(ConfigError):
    """Another run holds the store."""


class StoreError(TilerError):
    """A store that tiler did not write, of another version, or damaged."""


class ForeignStoreError(StoreError):
    """No store of this version is where one should be: another place has to be named."""

    exit_code = 2


class DamagedError(StoreError):
    """Objects of a store that are damaged or gone; a run does again what wrote them.

    Attributes
    ----------
    keys : tuple of str
        Their keys in the store.
    """

    def __init__(self, text: str, keys: tuple[str, ...] = ()) -> None:
        super().__init__(text, keys)
        self.keys = keys

    def __str__(self) -> str:
        return str(self.args[0])


class InputError(TilerError):
    """A source file that cannot be read, or a CRS that cannot be used."""

    exit_code = 3


class ProcessingError(TilerError):
    """The work itself failed: no tile succeeded, ``--on-error stop``."""

    again = True


class ConnectionLostError(ProcessingError):
    """The connection to the scheduler of a cluster broke."""


class DiskFullError(ProcessingError):
    """No space or quota is left: every other task would fail as well, so the run ends."""

    again = False


def refused_write(what: str, error: Exception, folder: Path | None = None) -> ProcessingError:
    """The one-line error of a write that the file system refused; a `DiskFullError` where there is no space.

    Parameters
    ----------
    what : str
        That could not be written.
    error : Exception
        An OSError; or that of a library, which does not say why it could not write.
    folder : Path, optional
        Where: its free space tells what a library does not.
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
        f"{what}: cannot be written ({reason}); see to the disk and its rights, and run again"
    )
