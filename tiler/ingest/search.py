"""Finds input clouds in files, folders, globs, virtual point clouds and EPT, without files that runs of tiler wrote."""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from tiler.errors import ConfigError, InputError
from tiler.ingest.point_tiles import PointTiles, Touches, is_point_tiles, node_files, read_point_tiles
from tiler.ingest.virtual_cloud import is_virtual, members
from tiler.io.locations import cloud_path, is_url, list_clouds
from tiler.io.partial_files import SCRATCH_PREFIX
from tiler.io.result_folder import ASIDE, CLASSIFIED, is_results

SUFFIXES = (".las", ".laz")

MADE = (CLASSIFIED, ASIDE)
"""Folders in OUT that hold clouds which runs wrote."""

Tell = Callable[[str], None]
Wanted = Callable[[PointTiles], Touches | None]


def find_inputs(
    paths: Sequence[str | Path],
    out: Path | None = None,
    note: Tell = lambda text: None,
    results: bool = False,
    wanted: Wanted = lambda tiles: None,
) -> list[Path]:
    """The LAS and LAZ files of files, folders (recursively), globs, virtual point clouds and EPT, sorted, each once.

    What a run of tiler wrote is found by neither folders nor globs, wherever it lies below them, but only where its own
    folder, or a file in it, is named.

    Parameters
    ----------
    paths : sequence of str
    out : Path, optional
        Folder of the run's own results: folders of it may be links that lead to where inputs are looked for.
    note : callable
        Told of what is left out, and of a file that was named twice.
    results : bool
        A folder of results that is named itself, and holds no cloud beside them, stands for its classified clouds.
    wanted : callable
        Gives what tells which nodes of point tiles are wanted (see `node_files`).

    Raises
    ------
    ConfigError
        A path that is not there, no path at all, or point tiles of which nothing is wanted.
    InputError
        No LAS or LAZ among them.
    """
    if not paths:
        raise ConfigError("no input; name LAS or LAZ files, folders, globs or .vpc files")
    found: dict[Path, Path] = {}
    told: list[str] = []

    def tell(text: str) -> None:
        told.append(text)
        note(text)

    for text in _without_virtual(map(str, paths), found, wanted):
        root, candidates = _expanded(text, tell)
        own = results and not is_url(text) and not any(path.parent == root for path in candidates)
        for path in _Made(root, root / CLASSIFIED if own else None, out, tell).without(candidates):
            if (known := found.setdefault(_real(path), path)) is not path:
                tell(f"{path}: named twice (as {known}), read once")
    if not found:
        raise InputError(
            f"{', '.join(map(str, paths))}: no .las or .laz file there"
            + "".join(f" ({text})" for text in told[:1])
            + "; name files, folders or globs"
        )
    return sorted(found.values(), key=lambda path: (is_url(path), str(path) if is_url(path) else path))


def is_list(text: str | Path) -> bool:
    """Whether an input is named as a file that stands for the clouds it tells of is: .vpc, or ept.json."""
    return is_virtual(text) or is_point_tiles(text)


def _without_virtual(texts: Iterable[str], found: dict[Path, Path], wanted: Wanted) -> Iterator[str]:
    """The inputs that are no virtual point clouds or EPT; the clouds that those name are found."""
    for text in texts:
        globbed = not is_url(text) and glob.has_magic(text) and not os.path.lexists(text)
        for place in sorted(glob.glob(text, recursive=True)) if globbed and is_list(text) else [text]:
            if not is_list(place) or Path(place).is_dir() or not (is_url(place) or os.path.lexists(place)):
                yield place
            else:
                for path in members(place, SUFFIXES) if is_virtual(place) else _nodes(place, wanted):
                    found.setdefault(_real(path), path)


def _nodes(place: str, wanted: Wanted) -> list[Path]:
    """The files of the nodes of point tiles that are wanted."""
    tiles = read_point_tiles(place)
    found = node_files(tiles, wanted(tiles))
    if not found:
        raise ConfigError(f"{place}: has no points near the area that is wanted; see to --bounds or --aoi")
    return found


def _real(path: Path) -> Path:
    """The place of a file, whatever links lead to it."""
    # Not `Path.resolve`, which fails for a link that leads in a circle: that is told of when it is read.
    return path if is_url(path) else Path(os.path.realpath(path))


def _expanded(text: str, note: Tell) -> tuple[Path, list[Path]]:
    """Where an input is looked for, and the clouds there."""
    if is_url(text):
        fixed = text[: _before_magic(text)].rpartition("/")[0] if glob.has_magic(text) else text
        return cloud_path(fixed if is_url(fixed) else text), list_clouds(text, SUFFIXES)
    if not text:
        raise ConfigError("an input has no name at all; name LAS or LAZ files, folders, globs or .vpc files")
    path = Path(text)
    try:
        is_folder, is_there = path.is_dir(), path.exists() or path.is_symlink()
    except OSError as error:
        raise ConfigError(
            f"{text}: {error.strerror}; name LAS or LAZ files, folders, globs or .vpc files"
        ) from error
    if is_folder:
        return path, list(_walk(path, note))
    if is_there:
        return path, [path]
    matches = sorted(glob.glob(text, recursive=True))
    if not matches:
        raise ConfigError(
            f"{text}: no such file or folder; name LAS or LAZ files, folders, globs or .vpc files"
        )
    found: list[Path] = []
    for match in map(Path, matches):
        if match.is_dir():
            found += _walk(match, note)
        elif match.suffix.lower() in SUFFIXES:
            found.append(match)
    return Path(text[: _before_magic(text)] + "x").parent, found


def _before_magic(pattern: str) -> int:
    """Characters of a glob that stand for themselves, at its beginning."""
    return min(pattern.index(sign) for sign in "*?[" if sign in pattern)


def _walk(folder: Path, note: Tell) -> Iterator[Path]:
    """The clouds below a folder; it does not follow links to folders, which may lead in circles or anywhere."""

    def unreadable(error: OSError) -> None:
        note(f"{error.filename}: cannot be looked into ({error.strerror}); what it holds is left out")

    for root, folders, names in os.walk(folder, onerror=unreadable):
        here = Path(root)
        folders[:] = sorted(name for name in folders if not name.startswith(SCRATCH_PREFIX))
        for name in folders:
            if (here / name).is_symlink():
                note(f"{here / name}: is a link to a folder, not followed; name it to read what it holds")
        yield from (here / name for name in sorted(names) if Path(name).suffix.lower() in SUFFIXES)


class _Made:
    """Recognises files that runs of tiler wrote, which are no inputs.

    Parameters
    ----------
    root : Path
        Where inputs are looked for; if it lies itself in such a folder, its clouds are wanted.
    wanted : Path or None
        A folder of results that is wanted all the same.
    out : Path or None
    note : callable
    """

    def __init__(self, root: Path, wanted: Path | None, out: Path | None, note: Tell) -> None:
        self._root, self._wanted, self._note = root, wanted, note
        self._known: dict[Path, bool] = {}
        self._told: set[Path] = set()
        self._linked: set[Path] = set()
        for folder in (out / name for name in MADE if out is not None):
            if self._is_made(folder):
                self._linked.add(Path(os.path.realpath(folder)))

    def without(self, paths: Sequence[Path]) -> Iterator[Path]:
        """Those of some paths that no run made; the folders of the others are told of once."""
        for path in paths:
            folder = self._folder_of(path)
            if folder is None:
                yield path
            elif folder not in self._told:
                self._told.add(folder)
                self._note(f"{folder}: is the result of a run, left out; name it to read what it holds")

    def _folder_of(self, path: Path) -> Path | None:
        """The folder of results below the root in which a path lies."""
        for folder in path.parents:
            if not self._is_below_root(folder):
                break
            if folder.name in MADE and folder != self._wanted and self._is_made(folder):
                return folder
        if self._linked and not is_url(path):
            here, root = Path(os.path.realpath(path.parent)), Path(os.path.realpath(self._root))
            for folder in self._linked:
                if here.is_relative_to(folder) and not root.is_relative_to(folder):
                    return folder
        return None

    def _is_below_root(self, folder: Path) -> bool:
        if is_url(folder):
            return str(folder).startswith(f"{str(self._root).rstrip('/')}/")
        return folder != self._root and folder.is_relative_to(self._root)

    def _is_made(self, folder: Path) -> bool:
        if folder not in self._known:
            self._known[folder] = is_results(str(folder.parent))
        return self._known[folder]
