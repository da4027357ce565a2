"""Refuses to write over an input, whatever name leads to it.

Every command that writes where its user says hands its targets to `check_targets`, before it writes the first of them.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from tiler.errors import ConfigError
from tiler.io.locations import is_url


@dataclass(frozen=True)
class Target:
    """A file that a command is to write.

    Attributes
    ----------
    option : str
        By which the user named it, empty for an argument.
    path : str or Path
        Path or URL.
    suffixes : tuple of str
        One of which its name must have; empty: it has none of its own choice.
    """

    option: str
    path: str | Path
    suffixes: tuple[str, ...] = ()


def check_targets(targets: Iterable[Target], reads: Iterable[str | Path]) -> None:
    """Raise ConfigError where a target is a file that the command reads, or has not the suffix of its kind.

    Files are compared, not names: links, hard links and spellings of a path are seen through.

    Parameters
    ----------
    targets : iterable of Target
    reads : iterable of str or Path
        Paths and URLs of all files that the command reads.
    """
    known = {identity: place for place in reads for identity in _identities(place)}
    for target in targets:
        named = f"{target.option} {target.path}".strip()
        if target.suffixes and Path(str(target.path)).suffix.lower() not in target.suffixes:
            raise ConfigError(
                f"{named}: would be of another kind than its name says; name it {target.suffixes[0]}"
            )
        for identity in _identities(target.path):
            if identity in known:
                raise ConfigError(
                    f"{named}: is an input ({known[identity]}); name another output, or give a copy of it"
                )


def check_folder(option: str, folder: str | Path, others: Iterable[str | Path]) -> None:
    """Raise ConfigError where a folder that a command makes its own is, or holds, one of some files or folders.

    Parameters
    ----------
    option : str
        By which the user named it, or what it is.
    folder : str or Path
        Path or URL.
    others : iterable of str or Path
        Paths and URLs: what the command reads, and where else it writes.
    """
    mine = real_place(folder)
    for other in others:
        theirs = real_place(other)
        if theirs == mine or theirs.startswith(mine.rstrip("/") + "/"):
            what = "is the same as" if theirs == mine else "holds"
            raise ConfigError(f"{option} {folder}: {what} {other}; name another place")


def real_place(place: str | Path) -> str:
    """A path without links and dots, or a URL without a slash at its end."""
    text = str(place)
    for scheme in ("file://", "local://"):
        text = text.removeprefix(scheme)
    return text.rstrip("/") if is_url(text) else os.path.realpath(text)


def _identities(place: str | Path) -> list[object]:
    """What a place has in common with every other name of the same file."""
    found: list[object] = [real_place(place)]
    if not is_url(real_place(place)):
        try:
            status = os.stat(real_place(place))
            found.append((status.st_dev, status.st_ino))
        except OSError:  # not there yet
            pass
    return found
