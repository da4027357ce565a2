"""Reading of Entwine Point Tiles (EPT, ``ept.json``): octrees with nodes in LAZ files of a folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, TypeGuard

from pyproj.exceptions import CRSError

from tiler.core.crs import crs_in_file
from tiler.errors import InputError
from tiler.inputs.lists import LIST_BYTES, MAX_CLOUDS
from tiler.io.cloud_reading import open_location
from tiler.io.foreign_content import excerpt, parse_json_object
from tiler.io.locations import as_path, is_url, reading_remedy

NAME = "ept.json"
DATA_FOLDER = "ept-data"

_MAX_WKT_BYTES = 1 << 20
_DEEPEST = 30
_FARTHEST = 1e12
"""Largest coordinate in units of the CRS, more than any CRS has. Larger ones would make the
side of a box inexact."""
_NOT_LOADED = -1
"""Number in a page of the hierarchy if another page contains the number of points."""

Box = tuple[float, float, float, float]
"""Lowest x, y, highest x, y in units of the CRS."""
Touches = Callable[[Box], bool]


@dataclass(frozen=True)
class EptDataset:
    """Content of ``ept.json``.

    Attributes
    ----------
    text : str
        Path or URL of the file.
    west, south, side : float
        Lower left corner and side of the root's square, in units of the CRS.
    wkt : str or None
        CRS in WKT; None if it is unknown.
    points : int or None
        Number of points in all nodes; None if it is unknown.
    scales : tuple of 3 float, or None
        Scales of x, y and z.
    has_rgb : bool or None
        Whether the points have colours; None if unknown.
    """

    text: str
    west: float
    south: float
    side: float
    wkt: str | None
    points: int | None = None
    scales: tuple[float, ...] | None = None
    has_rgb: bool | None = None

    def other_total(self, total: int) -> list[str]:
        """Return a note in a list if the hierarchy has another number of points, else an empty list."""
        if self.points in (None, total):
            return []
        return [
            f"{self.text}: says {self.points} points, its hierarchy {total}; the values in the files are used; "
            "create ept.json again"
        ]

    def place(self, folder: str, name: str) -> str:
        """Return the path or URL of a file in one of the folders next to ``ept.json``."""
        base, mark, query = self.text, "", ""
        if is_url(self.text):
            base, mark, query = self.text.partition("?")
        return f"{base[: -len(NAME)]}{folder}/{name}{mark}{query}"

    def box(self, key: Sequence[int]) -> Box:
        """Return the square of a node with the key level, column, row (and layer)."""
        side = self.side / 2 ** key[0]
        x, y = self.west + key[1] * side, self.south + key[2] * side
        return x, y, x + side, y + side


def is_ept(text: str | Path) -> bool:
    """Return whether an input has the file name ``ept.json``."""
    path = str(text).partition("?")[0] if is_url(text) else str(text)
    return path.lower().replace("\\", "/").rpartition("/")[2] == NAME


def read_point_tiles(text: str) -> EptDataset:
    """Read ``ept.json``.

    Raise InputError if it cannot be read, or if its points are not in LAZ files.
    """
    content = _read(text, text)
    kind = content.get("dataType")
    bounds = content.get("bounds")
    if kind != "laszip":
        _refuse(
            text,
            f"its points are of the type {excerpt(str(kind))}, but only laszip can be read",
            "convert it to laszip",
        )
    if not _is_cube(bounds):
        _refuse(text, f"has bounds {excerpt(str(bounds))}, no cube")
    points = content.get("points")
    if not isinstance(points, int) or abs(points) >= 1 << 63:
        points = None
    scales, has_rgb = _schema(content)
    return EptDataset(
        text=text,
        west=float(bounds[0]),
        south=float(bounds[1]),
        side=float(bounds[3] - bounds[0]),
        wkt=_wkt(text, content),
        points=points,
        scales=scales,
        has_rgb=has_rgb,
    )


def _is_cube(bounds: Any) -> TypeGuard[list[float]]:
    if not isinstance(bounds, list) or len(bounds) != 6:
        return False
    return all(map(_is_coordinate, bounds)) and bounds[3] > bounds[0]


def _is_coordinate(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and abs(value) <= _FARTHEST


def _schema(found: Mapping[str, Any]) -> tuple[tuple[float, ...] | None, bool | None]:
    """Return the scales of x, y and z, and whether there are colours.

    Each is None if the schema does not define it.
    """
    schema = found.get("schema")
    if not isinstance(schema, list):
        return None, None
    named = {
        str(entry.get("name")): entry.get("scale")
        for entry in schema
        if isinstance(entry, dict)
    }
    has_rgb = named.keys() >= {"Red", "Green", "Blue"}
    scales = tuple(float(scale) for scale in map(named.get, "XYZ") if _is_coordinate(scale))
    if len(scales) != len("XYZ"):
        return None, has_rgb
    return scales, has_rgb


def node_files(tiles: EptDataset, touches: Touches | None = None) -> dict[str, int]:
    """Return the path or URL of each node with points, root first, with its number of points.

    The numbers are those of the hierarchy.

    Parameters
    ----------
    tiles : EptDataset
    touches : callable, optional
        Predicate for the square of a node. Nodes for which it is false are left out with all nodes below them.

    Raises
    ------
    InputError
        A page of the hierarchy is damaged or missing, or no node has points although there is no predicate.
    """
    counts = sorted(node_counts(tiles, touches).items())
    return {
        tiles.place(DATA_FOLDER, f"{'-'.join(map(str, key))}.laz"): count
        for key, count in counts
    }


def key_of(path: Path) -> tuple[int, ...] | None:
    """Return the key of a node from the name of its file, or None if it is not the name of a node."""
    return _key(path.name.rpartition(".")[0])


def node_counts(
    tiles: EptDataset, touches: Touches | None = None
) -> dict[tuple[int, ...], int]:
    """Return the number of points of each node by its key: level, column, row and layer.

    `node_files` describes the parameters and errors.
    """
    counts: dict[tuple[int, ...], int] = {}
    for key, count in _nodes(tiles, touches):
        if counts.setdefault(key, count) != count or len(counts) > MAX_CLOUDS:
            name = "-".join(map(str, key))
            _refuse(
                tiles.text,
                f"its hierarchy names the node {name} twice, or more than {MAX_CLOUDS} nodes",
            )
    if not any(counts.values()) and touches is None:
        _refuse(tiles.text, "its hierarchy names no points")
    return {key: count for key, count in counts.items() if count}


def _nodes(tiles: EptDataset, touches: Touches | None) -> Iterator[tuple[tuple[int, ...], int]]:
    """Yield the keys and numbers of points of the selected nodes, page by page."""
    pages = [(0, 0, 0, 0)]
    seen = set[tuple[int, ...]]()
    while pages:
        page = pages.pop()
        if page in seen:
            _refuse(
                tiles.text, f"its hierarchy leads to the page {'-'.join(map(str, page))} twice"
            )
        seen.add(page)
        name = "-".join(map(str, page))
        entries = _read(tiles.text, tiles.place("ept-hierarchy", f"{name}.json"))
        for text, count in entries.items():
            key = _key(text)
            if (
                key is None
                or isinstance(count, bool)
                or not isinstance(count, int)
                or count < _NOT_LOADED
            ):
                _refuse(
                    tiles.text,
                    f"the page {name} of its hierarchy says {excerpt(f'{text}: {count}')}",
                )
            if touches is not None and not touches(tiles.box(key)):
                continue
            if count != _NOT_LOADED:
                yield key, count
            elif key == page:
                _refuse(tiles.text, f"the page {name} of its hierarchy has no number of points")
            else:
                pages.append(key)


def _key(text: str) -> tuple[int, int, int, int] | None:
    parts = text.split("-")
    if len(parts) != 4 or not all(
        part.isascii() and part.isdigit() and len(part) < 11 for part in parts
    ):
        return None
    level, x, y, z = map(int, parts)
    if level > _DEEPEST or max(x, y, z) >= 1 << level:
        return None
    return level, x, y, z


def _wkt(text: str, found: Mapping[str, Any]) -> str | None:
    """Return the CRS from its WKT, or from its codes if the WKT is missing or cannot be read."""
    srs = found.get("srs")
    if not isinstance(srs, dict):
        return None
    wkt = srs.get("wkt")
    if len(str(wkt)) > _MAX_WKT_BYTES:
        _refuse(text, f"its CRS has more than {_MAX_WKT_BYTES} characters")
    definitions = [wkt]
    codes = [str(srs[name]) for name in ("horizontal", "vertical") if srs.get(name)]
    if srs.get("authority") and codes:
        definitions.append(f"{srs['authority']}:{'+'.join(codes)}")
    for definition in definitions:
        if not isinstance(definition, str) or not definition:
            continue
        try:
            return str(crs_in_file(definition).to_wkt())
        # JSON may contain a lone surrogate, which cannot be encoded.
        except (CRSError, UnicodeEncodeError):
            continue
    return None


def _read(text: str, place: str) -> dict[str, Any]:
    try:
        with open_location(as_path(place), 1 << 16) as stream:
            content = stream.read(LIST_BYTES + 1)
    except OSError as error:
        _refuse(
            text,
            f"{place} cannot be read ({error.strerror or error})",
            reading_remedy(place, "get it again"),
        )
    if len(content) > LIST_BYTES:
        _refuse(text, f"{place} has more than {LIST_BYTES >> 20} MiB")
    try:
        return parse_json_object(content)
    except ValueError as error:  # This includes errors of UTF-8.
        _refuse(text, f"{place}: {' '.join(str(error).split())}")


def _refuse(text: str, what: str, remedy: str = "make it again") -> NoReturn:
    raise InputError(f"{text}: the file is not a readable EPT data set: {what}; {remedy}")
