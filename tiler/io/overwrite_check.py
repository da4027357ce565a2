"""Checks that no output overwrites an input, even if it has another name.

Every command that reads files calls `check_targets` with the output files that the user gives,
before it writes any of them.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from tiler.core.file_names import fault_on_windows, link_error
from tiler.errors import ConfigError
from tiler.io.atomic_files import MAX_NAME_LENGTH, name_bytes
from tiler.io.locations import is_url, plain_scheme, without_local_scheme

_EXTENDED = re.compile(r"^[\\/]{2}[?.][\\/](?:(?=[A-Za-z]:)|UNC(?=[\\/]))", re.IGNORECASE)
"""Prefix with which Windows takes a path as it is, also that of a server. It names the same file as the path without
it, which begins with a drive or, for a server, with two separators."""


@dataclass(frozen=True)
class Target:
    """File that a command will write.

    Attributes
    ----------
    option : str
        Option with which the user gives the file, or empty for an argument.
    path : str or Path
        Path or URL of the file.
    suffixes : tuple of str
        Allowed suffixes, or empty if every suffix is allowed.
    """

    option: str
    path: str | Path
    suffixes: tuple[str, ...] = ()


def check_targets(targets: Iterable[Target], reads: Iterable[str | Path]) -> None:
    """Raise ConfigError if a target is a file that the command reads, or its name is too long or has a wrong suffix.

    Files are compared, not names, so links, hard links and other spellings of a path are
    recognised.

    Parameters
    ----------
    targets : iterable of Target
    reads : iterable of str or Path
        Paths and URLs of all files that the command reads.
    """
    known: dict[object, str | Path] = {}
    for source in reads:
        known.update(dict.fromkeys(_identities(source), source))
    for target in targets:
        named = f"{target.option} {target.path}".strip()
        if target.suffixes and Path(str(target.path)).suffix.lower() not in target.suffixes:
            raise ConfigError(
                f"{named}: its suffix does not match the kind of file; use {target.suffixes[0]}"
            )
        check_names(target.option, target.path)
        for identity in _identities(target.path):
            if identity in known:
                raise ConfigError(
                    f"{named} is an input ({known[identity]}); give another output, or a copy of the input"
                )


def check_difference(path: str | Path, reads: Iterable[str | Path]) -> None:
    """Raise ConfigError if ``--difference`` is not the name of a GeoTIFF in a folder of this machine, or is an input.

    Parameters
    ----------
    path : str or Path
    reads : iterable of str or Path
        Paths and URLs of all files that the command reads.
    """
    target = Path(path)
    if is_url_path(target):
        raise ConfigError(f"--difference {path}: is a URL; give a file on this machine")
    check_targets([Target("--difference", path, (".tif", ".tiff"))], reads)
    if target.is_dir():
        raise ConfigError(f"--difference {path}: is a folder; give a file")
    if not target.parent.is_dir():
        raise ConfigError(
            f"--difference {path}: its folder does not exist; make it, or give another file"
        )


def is_url_path(path: Path) -> bool:
    """Return whether a path was made from a URL. Such a path has only one slash, and a drive of Windows one letter."""
    return re.match("[A-Za-z][A-Za-z0-9+.-]+:/", path.as_posix()) is not None


def check_names(option: str, place: str | Path) -> None:
    """Raise ConfigError if the system does not allow a part of a path as a name."""
    text = without_local_scheme(plain_scheme(str(place)))
    if is_url(text):
        return
    for name in Path(text).relative_to(Path(text).anchor).parts:
        fault = fault_on_windows(name) if os.name == "nt" else ""
        if fault:
            raise ConfigError(f"{option} {place}: {name!r} {fault}; give another name")
        if name_bytes(name) > MAX_NAME_LENGTH:
            raise ConfigError(
                f"{option} {name[:20]}...: its name has {name_bytes(name)} bytes, {MAX_NAME_LENGTH} are possible; "
                "give a shorter name"
            )


def check_folder(option: str, folder: str | Path, others: Iterable[str | Path]) -> None:
    """Raise ConfigError if a folder that a command will write to is, or contains, one of the ``others``.

    Parameters
    ----------
    option : str
        Option with which the user gives the folder, or a description of the folder.
    folder : str or Path
        Path or URL of the folder.
    others : iterable of str or Path
        Paths and URLs that the command reads, or to which it writes as well.
    """
    folder_path = real_place(folder)
    for other in others:
        other_path = real_place(other)
        separator = "/" if is_url(folder_path) else os.sep
        inside = other_path.startswith(folder_path.rstrip(separator) + separator)
        if other_path == folder_path or inside:
            relation = "is the same as" if other_path == folder_path else "contains"
            raise ConfigError(f"{option} {folder}: {relation} {other}; give another folder")


def check_links(option: str, out: str | Path, names: Iterable[str]) -> None:
    """Raise ConfigError if a folder in OUT to which a command will write is a link.

    OUT itself may be a link, as the user gives it. Links in OUT may be those of other users who can write there.

    Parameters
    ----------
    option : str
        Option with which the user gives the folder, or empty for an argument.
    out : str or Path
        Path or URL of the folder.
    names : iterable of str
        Files that the command will write, as paths in OUT.
    """
    if is_url(real_place(out)):
        return
    folders = {folder for name in names for folder in Path(name).parents}
    for folder in sorted(folders - {Path()}):
        if Path(out, folder).is_symlink():
            raise link_error(Path(out, folder), option)


def real_place(place: str | Path) -> str:
    """Return a path without links and dots, in lower case on Windows, or a URL without a slash at its end."""
    text = without_local_scheme(plain_scheme(str(place)))
    if is_url(text):
        return text.rstrip("/")
    return os.path.normcase(
        os.path.realpath(without_extended_prefix(text) if os.name == "nt" else text)
    )


def without_extended_prefix(path: str) -> str:
    r"""Return a path of Windows without ``\\?\``, and that of a server with two separators."""
    return _EXTENDED.sub(lambda prefix: "\\" if prefix[0][-1] in "cC" else "", path)


def same_file(one: str | Path, other: str | Path) -> bool:
    """Return whether two paths or URLs are names of the same file."""
    return not set(_identities(one)).isdisjoint(_identities(other))


def _identities(place: str | Path) -> list[object]:
    """Return values that are equal for all names of the same file."""
    identities: list[object] = [real_place(place)]
    if not is_url(real_place(place)):
        try:
            status = os.stat(real_place(place))
            identities.append((status.st_dev, status.st_ino))
        except OSError:  # The file does not exist yet.
            pass
    return identities
