"""Entwine point tiles (EPT, ``ept.json``): an octree of LAZ files, one for each node, below one folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from pyproj import CRS
from pyproj.exceptions import CRSError

from tiler.errors import InputError
from tiler.io.cloud_reading import open_cloud
from tiler.io.json_text import excerpt, read_object
from tiler.io.locations import cloud_path, is_url

NAME = "ept.json"
MOST_BYTES = 1 << 28
"""Of such a file, and of a page of the hierarchy."""
MOST_NODES = 1 << 20

_DEEPEST = 30
_FARTHEST = 1e12
"""Units from the origin, which no CRS reaches; beyond it are numbers that no float holds, and boxes without a side."""
_NOT_LOADED = -1
"""In place of a number of points: a page of its own tells it."""

Box = tuple[float, float, float, float]
"""Lowest x, y, highest x, y in units of the CRS."""
Touches = Callable[[Box], bool]


@dataclass(frozen=True)
class PointTiles:
    """What ``ept.json`` says.

    Attributes
    ----------
    text : str
        Its path or URL.
    west, south, side : float
        Lower left corner and side of the root's square, in units of the CRS.
    wkt : str or None
        The CRS.
    """

    text: str
    west: float
    south: float
    side: float
    wkt: str | None

    def place(self, folder: str, name: str) -> str:
        """Path or URL of a file in one of the folders beside it."""
        base, mark, query = self.text.partition("?") if is_url(self.text) else (self.text, "", "")
        return f"{base[: -len(NAME)]}{folder}/{name}{mark}{query}"

    def box(self, key: Sequence[int]) -> Box:
        """The square of a node: level, column, row (and layer)."""
        side = self.side / 2 ** key[0]
        x, y = self.west + key[1] * side, self.south + key[2] * side
        return x, y, x + side, y + side


def is_point_tiles(text: str | Path) -> bool:
    """Whether an input is named as the description of an EPT data set is."""
    place = str(text).partition("?")[0] if is_url(text) else str(text)
    return place.lower().replace("\\", "/").rpartition("/")[2] == NAME


def read_point_tiles(text: str) -> PointTiles:
    """What ``ept.json`` says; raises InputError where it cannot be read, or its points are not LAZ files."""
    found = _read(text, text)
    kind, bounds = found.get("dataType"), found.get("bounds")
    if kind != "laszip":
        _refuse(
            text,
            f"its points are of the type {excerpt(str(kind))}, laszip can be read",
            "convert it to laszip",
        )
    if not (
        isinstance(bounds, list) and len(bounds) == 6
        and all(isinstance(v, int | float) and abs(v) <= _FARTHEST for v in bounds) and bounds[3] > bounds[0]
    ):  # fmt: skip
        _refuse(text, f"has bounds {excerpt(str(bounds))}, no cube")
    return PointTiles(
        text, float(bounds[0]), float(bounds[1]), float(bounds[3] - bounds[0]), _wkt(text, found)
    )


def node_files(tiles: PointTiles, touches: Touches | None = None) -> list[Path]:
    """The files of the nodes that hold points, root first.

    Parameters
    ----------
    tiles : PointTiles
    touches : callable, optional
        Tells whether the square of a node is wanted; those below one that is not are not looked at.

    Raises
    ------
    InputError
        A page of the hierarchy is damaged or missing.
    """
    names = ["-".join(map(str, key)) for key in sorted(node_counts(tiles, touches))]
    return [cloud_path(tiles.place("ept-data", f"{name}.laz")) for name in names]


def node_counts(tiles: PointTiles, touches: Touches | None = None) -> dict[tuple[int, ...], int]:
    """Number of points of each node that holds some, by level, column, row and layer; else as `node_files`."""
    counts: dict[tuple[int, ...], int] = {}
    for key, count in _nodes(tiles, touches):
        if counts.setdefault(key, count) != count or len(counts) > MOST_NODES:
            name = "-".join(map(str, key))
            _refuse(tiles.text, f"its hierarchy names the node {name} twice, or more than {MOST_NODES} nodes")
    if not any(counts.values()) and touches is None:
        _refuse(tiles.text, "its hierarchy names no points")
    return {key: count for key, count in counts.items() if count}


def _nodes(tiles: PointTiles, touches: Touches | None) -> Iterator[tuple[tuple[int, ...], int]]:
    """Keys and points of the nodes that are wanted, page by page."""
    pages, seen = [(0, 0, 0, 0)], set[tuple[int, ...]]()
    while pages:
        page = pages.pop()
        if page in seen:
            _refuse(tiles.text, f"its hierarchy leads to the page {'-'.join(map(str, page))} twice")
        seen.add(page)
        name = "-".join(map(str, page))
        entries = _read(tiles.text, tiles.place("ept-hierarchy", f"{name}.json"))
        for text, count in entries.items():
            key = _key(text)
            if key is None or isinstance(count, bool) or not isinstance(count, int) or count < _NOT_LOADED:
                _refuse(tiles.text, f"the page {name} of its hierarchy says {excerpt(f'{text}: {count}')}")
            if touches is not None and not touches(tiles.box(key)):
                continue
            if count != _NOT_LOADED:
                yield key, count
            elif key == page:
                _refuse(tiles.text, f"the page {name} of its hierarchy does not say how many points it has")
            else:
                pages.append(key)


def _key(text: str) -> tuple[int, int, int, int] | None:
    parts = text.split("-")
    if len(parts) != 4 or not all(part.isascii() and part.isdigit() and len(part) < 11 for part in parts):
        return None
    level, x, y, z = map(int, parts)
    return (level, x, y, z) if level <= _DEEPEST and max(x, y, z) < 1 << level else None


def _wkt(text: str, found: Mapping[str, Any]) -> str | None:
    """The CRS, by its WKT or by its codes."""
    srs = found.get("srs")
    if not isinstance(srs, dict):
        return None
    codes = [str(srs[name]) for name in ("horizontal", "vertical") if srs.get(name)]
    named = f"{srs.get('authority')}:{'+'.join(codes)}" if srs.get("authority") and codes else None
    for known in (srs.get("wkt"), named):
        if isinstance(known, str) and known:
            try:
                return str(CRS.from_user_input(known).to_wkt())
            except (CRSError, UnicodeEncodeError):  # half of a character: JSON can write it
                continue
    return None


def _read(text: str, place: str) -> dict[str, Any]:
    try:
        with open_cloud(cloud_path(place), 1 << 16) as stream:
            content = stream.read(MOST_BYTES + 1)
    except OSError as error:
        _refuse(text, f"{place} cannot be read ({error.strerror or error})", "get it again")
    if len(content) > MOST_BYTES:
        _refuse(text, f"{place} has more than {MOST_BYTES >> 20} MiB")
    try:
        return read_object(content)
    except ValueError as error:  # of bytes that are no UTF-8 as well
        _refuse(text, f"{place}: {' '.join(str(error).split())}")


def _refuse(text: str, what: str, remedy: str = "make it again") -> NoReturn:
    raise InputError(f"{text}: no point tiles (EPT) that can be read: {what}; {remedy}")
