"""Search for input clouds in files, folders, globs, virtual point clouds and EPT.

Clouds that runs wrote are left out.
"""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path

from tiler.core import words
from tiler.errors import ConfigError, InputError
from tiler.inputs.lists import is_virtual, members, read_list
from tiler.inputs.point_tiles import EptDataset, Touches, is_ept, node_files, read_point_tiles
from tiler.io.atomic_files import SCRATCH_PREFIX
from tiler.io.cloud_formats import FORMAT_NAMES, SUFFIXES
from tiler.io.locations import as_path, is_url, list_inputs
from tiler.io.result_folder import CLASSIFIED, OUTDATED, OVERVIEW, VIRTUAL, is_results

_GIVE = f"give {FORMAT_NAMES} files, folders, globs or .vpc files"
PACKED = (".zip", ".gz", ".zst", ".bz2", ".xz", ".7z", ".rar")
"""Suffixes of packed files, which may contain clouds. They have to be unpacked first."""

MADE = (CLASSIFIED, OUTDATED)
"""Folders in OUT into which a run writes clouds."""

Tell = Callable[[str], None]
FileNumber = tuple[int, int]
"""Numbers of a device and of a file on it, which are the same for all hard links to the file."""
Wanted = Callable[[EptDataset], Touches | None]
Listed = Callable[[EptDataset, dict[Path, int]], None]
Unlisted = Callable[[str, InputError], None]


def find_inputs(
    paths: Sequence[str | Path],
    out: Path | None = None,
    note: Tell = lambda text: None,
    results: bool = False,
    wanted: Wanted = lambda tiles: None,
    listed: Listed = lambda tiles, counts: None,
    in_process: bool = False,
    unlisted: Unlisted | None = None,
) -> list[Path]:
    """Find clouds in files, folders (recursively), globs, virtual point clouds and EPT.

    Clouds that a run of tiler wrote are found only if their own folder or a file in it is
    given. They are not found through a folder or a glob above it.

    Parameters
    ----------
    paths : sequence of str
    out : Path, optional
        Folder of the run's own results. If a folder of clouds in it is a link, its target counts as results, too.
    note : callable
        Function that receives a text about each folder that is left out, and about each file that is given twice.
    results : bool
        Whether to read the classified clouds of a given folder of results that does not directly contain clouds.
    wanted : callable
        Function that makes the predicate for the nodes of point tiles (see `node_files`).
    listed : callable
        Function that receives point tiles and the files of their selected nodes, with the number of points in each.
    in_process : bool
        Read virtual point clouds and EPT in this process, without limits of time and memory.
    unlisted : callable, optional
        Function that receives each input that cannot be listed, and its error. Without it, or
        if no cloud is found, the error is raised.

    Returns
    -------
    list of Path
        Files, sorted, each once, then URLs.

    Raises
    ------
    ConfigError
        There are no paths, a path does not exist, or no node of point tiles is selected.
    InputError
        No cloud was found, or a list of clouds, or a folder at a URL, cannot be read.
    """
    if not paths:
        raise ConfigError(f"no input; {_GIVE}")
    clouds: dict[Path | FileNumber, Path] = {}
    reported: list[str] = []
    packed: list[str] = []
    failed: InputError | None = None

    def report(text: str) -> None:
        reported.append(text)
        note(text)

    for text in chain.from_iterable(_globbed_lists(str(path)) for path in paths):
        try:
            if is_list(text) and (
                is_url(text) or (os.path.lexists(text) and not Path(text).is_dir())
            ):
                for path in _listed(text, wanted, listed, in_process):
                    clouds.setdefault(_identity(path), path)
                continue
            root, candidates = _expanded(text, report, packed)
        except InputError as error:
            if unlisted is None:
                raise
            unlisted(text, error)
            failed = failed or error
            continue
        overviews = [p for p in candidates if str(p) != text and _is_overview(p)]
        for path in overviews:
            report(f"{path}: is the overview of classified clouds, left out")
        candidates = [path for path in candidates if path not in overviews]
        reads_results = (
            results and not is_url(text) and not any(path.parent == root for path in candidates)
        )
        made = _Made(root, root / CLASSIFIED if reads_results else None, out, report)
        for path in made.without(candidates):
            known = clouds.setdefault(_identity(path), path)
            if known is not path:
                report(f"{path}: named twice (as {known}), read once")
    if failed and not clouds:
        raise failed
    if not clouds:
        why, remedy = f" ({reported[0]})" if reported else "", "give files, folders or globs"
        if packed and not reported:
            why += f", but packed files ({words.listed(packed, 2, 'files')})"
            remedy = f"unpack them and give the {FORMAT_NAMES} files in them"
        raise InputError(
            f"{', '.join(map(str, paths))}: no {words.alternatives(SUFFIXES)} file there{why}; {remedy}"
        )
    urls = sorted((path for path in clouds.values() if is_url(path)), key=str)
    return sorted(path for path in clouds.values() if not is_url(path)) + urls


def _is_overview(path: Path) -> bool:
    """Return whether a cloud is the overview of the classified clouds beside it, also in a copy of them."""
    return path.name == OVERVIEW and (
        is_results(str(path.parent)) or (path.parent / VIRTUAL).is_file()
    )


def is_list(text: str | Path) -> bool:
    """Return whether an input has the name of a file that lists clouds: ``.vpc`` or ``ept.json``."""
    return is_virtual(text) or is_ept(text)


def _globbed_lists(text: str) -> list[str]:
    """Return the files that a glob for lists matches, or else the input itself."""
    globbed = not is_url(text) and glob.has_magic(text) and not os.path.lexists(text)
    if globbed and is_list(text):
        return sorted(glob.glob(text, recursive=True))
    return [text]


def _listed(text: str, wanted: Wanted, listed: Listed, in_process: bool) -> list[Path]:
    """Return the clouds in a virtual point cloud, or the files of the selected nodes of point tiles."""
    if is_virtual(text):
        locations = read_list(text, members, text, SUFFIXES, in_process=in_process)
        return [as_path(location) for location in locations]
    tiles = read_list(text, read_point_tiles, text, in_process=in_process)
    node_counts = read_list(text, node_files, tiles, wanted(tiles), in_process=in_process)
    if not node_counts:
        raise ConfigError(
            f"{text}: has no points near the requested area; check --bounds or --aoi"
        )
    counts = {as_path(location): count for location, count in node_counts.items()}
    listed(tiles, counts)
    return list(counts)


def _identity(path: Path) -> Path | FileNumber:
    """Return what all links to a file have in common: its path, or its number if it has hard links."""
    if is_url(path):
        return path
    try:
        status = os.stat(path)
    except OSError:  # Reading reports files that are missing, and circular links.
        return Path(os.path.realpath(path))
    # Some network drives number no file, or several alike, but these have no hard links either.
    if status.st_nlink > 1 and status.st_ino:
        return status.st_dev, status.st_ino
    return Path(os.path.realpath(path))


def _expanded(text: str, note: Tell, packed: list[str]) -> tuple[Path, list[Path]]:
    """Return the root folder (or file) of an input, and the clouds there. Append packed clouds to ``packed``."""
    if is_url(text):
        fixed = text[: _glob_base(text)].rpartition("/")[0] if glob.has_magic(text) else text
        return as_path(fixed if is_url(fixed) else text), list_inputs(text, SUFFIXES)
    if not text:
        raise ConfigError(f"an input has no name at all; {_GIVE}")
    path = Path(text)
    try:
        is_folder, is_there = path.is_dir(), path.exists() or path.is_symlink()
    except OSError as error:
        raise ConfigError(f"{text}: {error.strerror}; {_GIVE}") from error
    if is_folder:
        return path, list(_walk(path, note, packed))
    if is_there:
        return path, [path]
    matches = sorted(glob.glob(text, recursive=True))
    if not matches:
        raise ConfigError(f"{text}: no such file or folder; {_GIVE}")
    clouds: list[Path] = []
    for match in map(Path, matches):
        if match.is_dir():
            clouds += _walk(match, note, packed)
        elif match.suffix.lower() in SUFFIXES:
            clouds.append(match)
        elif match.suffix.lower() in PACKED:
            packed.append(str(match))
    return Path(text[: _glob_base(text)] + "x").parent, clouds


def _glob_base(pattern: str) -> int:
    """Return the number of characters before the first wildcard of a glob."""
    return min(pattern.index(sign) for sign in "*?[" if sign in pattern)


def _walk(folder: Path, note: Tell, packed: list[str]) -> Iterator[Path]:
    """Yield the clouds in a folder, recursively. Append packed clouds to ``packed``.

    Links to folders are not followed, because they may be circular or lead anywhere.
    """

    def unreadable(error: OSError) -> None:
        note(f"{error.filename}: cannot be listed ({error.strerror}); skipped")

    for root, folders, names in os.walk(folder, onerror=unreadable):
        here = Path(root)
        folders[:] = sorted(name for name in folders if not name.startswith(SCRATCH_PREFIX))
        for name in folders:
            if (here / name).is_symlink():
                note(
                    f"{here / name} is a link to a folder, not followed; give it as an input to read it"
                )
        for name in sorted(names):
            if Path(name).suffix.lower() in SUFFIXES:
                yield here / name
            elif Path(name).suffix.lower() in PACKED:
                packed.append(str(here / name))


class _Made:
    """Filter that removes clouds that runs of tiler wrote, because they are not inputs.

    Parameters
    ----------
    root : Path
        Root of the search. If it lies in a folder of results, the clouds of that folder are inputs.
    wanted : Path or None
        Folder of results whose clouds are inputs nevertheless.
    out : Path or None
    note : callable
    """

    def __init__(self, root: Path, wanted: Path | None, out: Path | None, note: Tell) -> None:
        self._root, self._wanted, self._note = root, wanted, note
        self._known: dict[Path, bool] = {}
        self._reported: set[Path] = set()
        self._linked: set[Path] = set()
        if out is None:
            return
        for name in MADE:
            if self._is_made(out / name):
                self._linked.add(Path(os.path.realpath(out / name)))

    def without(self, paths: Sequence[Path]) -> Iterator[Path]:
        """Yield the paths that no run wrote. Report each folder that is left out to ``note`` once."""
        for path in paths:
            folder = self._folder_of(path)
            if folder is None:
                yield path
            elif folder not in self._reported:
                self._reported.add(folder)
                self._note(
                    f"{folder} is the result of a run, left out; give it as an input to read it"
                )

    def _folder_of(self, path: Path) -> Path | None:
        """Return the folder of results below the root that contains a path, or None."""
        for folder in path.parents:
            if not self._is_below_root(folder):
                break
            if folder.name in MADE and folder != self._wanted and self._is_made(folder):
                return folder
        if not self._linked or is_url(path):
            return None
        here = Path(os.path.realpath(path.parent))
        root = Path(os.path.realpath(self._root))
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
