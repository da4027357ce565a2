"""The one exception tree; each class knows the exit code that the command line ends with."""

from __future__ import annotations


class TilerError(Exception):
    """Anything that tiler refuses or cannot do; the message is one line: what, where, value, remedy."""

    exit_code = 4


class ConfigError(TilerError):
    """Usage, configuration, or a plan that cannot work."""

    exit_code = 2


class LockedError(ConfigError):
    """Another run holds the store."""


class StoreError(TilerError):
    """A store that tiler did not write, of another version, or damaged."""


class InputError(TilerError):
    """A source file that cannot be read, or a CRS that cannot be used."""

    exit_code = 3


class ProcessingError(TilerError):
    """The work itself failed: disk full, no tile succeeded, ``--on-error stop``."""


class Interrupted(TilerError):
    """Ctrl-C or SIGTERM: the same command goes on where it was."""

    exit_code = 130
