"""Standing and running water: polygons in which the terrain is level or falls along a line."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ptd.arrays import AnyArray, Bool, Float32, Float64, Int64
from tiler.core.area import Area, AreaIndex
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds
from tiler.core.raster import Block, RasterSpec, within
from tiler.core.records import digest_of_bytes

Counts = Int64

LAKE, RIVER = "lake", "river"
KINDS = {
    LAKE: LAKE, "pond": LAKE, "reservoir": LAKE, "basin": LAKE, "sea": LAKE, "lagoon": LAKE,
    RIVER: RIVER, "stream": RIVER, "canal": RIVER, "ditch": RIVER,
}  # fmt: skip
"""Names of kinds in files, with the kind of each: level like a lake or falling like a river."""


POINTS_AT_ONCE = 1 << 13
"""Number of points that `places_along` compares with a segment at once, so that they stay in
the cache."""


class Station(NamedTuple):
    """Position along a river at which its level was estimated, in absolute counts.

    Attributes
    ----------
    x, y : int
        Position of the station.
    level : int
        Level of the water.
    seen : int
        Number of pixels of the water from which the level was estimated, or 0 if it was estimated from the banks.
    left, right : int or None
        Level estimated from the left and from the right bank, looking downstream, or None if there is no data there.
    """

    x: int
    y: int
    level: int
    seen: int
    left: int | None
    right: int | None


@dataclass(frozen=True, eq=False)
class Water:
    """Body of water.

    Attributes
    ----------
    number : int
        Number of the body, starting at 1.
    kind : str
        `LAKE` or `RIVER`.
    area : Area
        Polygons of the body.
    level : int or None
        Height of a lake, or of a river without a line, in counts. None until it is known.
    flow : int64 (n, 2 or 3) or None
        Line of a river in absolute counts: x, y, and the height of the water once it is known. The height never rises
        from a vertex to the next. A position in the river has the height of the nearest position on the line.
    confidence : float or None
        Confidence that this is water, 0 to 1, or None for water drawn by the user.
    stations : tuple of Station
        Stations from which the heights of a river were estimated, downstream. Empty if its heights were given.
    """

    number: int
    kind: str
    area: Area
    level: int | None = None
    flow: Counts | None = None
    confidence: float | None = None
    stations: tuple[Station, ...] = ()

    @property
    def levelled(self) -> bool:
        """Whether the heights of the body are known."""
        return self.level is not None or (self.flow is not None and self.flow.shape[1] == 3)

    @property
    def range(self) -> tuple[float, float]:
        """Highest and lowest level, in units of the CRS."""
        z = (
            [self.level]
            if self.level is not None or self.flow is None
            else self.flow[:, 2].tolist()
        )
        return max(z) / COUNTS_PER_UNIT, min(z) / COUNTS_PER_UNIT

    @cached_property
    def digest(self) -> list[Any]:
        """Values on which results depend."""
        flow = None if self.flow is None else self.flow.tolist()
        return [
            self.kind,
            self.area.key,
            self.level,
            flow,
            [list(station) for station in self.stations],
        ]

    def heights(self, x: Counts, y: Counts) -> Float64:
        """Return the levels at positions in absolute counts, in whole counts."""
        if self.level is not None or self.flow is None:
            return np.full(x.shape, float(self.level or 0))
        along = places_along(self.flow, x, y)
        heights: Float64 = np.rint(np.interp(along, lengths_along(self.flow), self.flow[:, 2]))
        return heights

    def to_json(self) -> dict[str, Any]:
        """Return a JSON-able description, which `from_json` reads."""
        flow = None if self.flow is None else self.flow.tolist()
        return {
            "number": self.number, "kind": self.kind, "rings": self.area.to_json(), "level": self.level,
            "flow": flow, "sure": self.confidence, "stations": [list(station) for station in self.stations],
        }  # fmt: skip

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Water:
        """Return the water that `to_json` described."""
        flow = None if data["flow"] is None else np.array(data["flow"], np.int64)
        area = Area.from_json(data["rings"])
        stations = tuple(Station(*station) for station in data["stations"])
        return cls(
            data["number"], data["kind"], area, data["level"], flow, data["sure"], stations
        )


def lengths_along(line: AnyArray) -> Float64:
    """Return the length of a line up to each vertex, in counts."""
    steps = np.hypot(*np.diff(line[:, :2].astype(np.float64), axis=0).T)
    return np.concatenate(([0.0], np.cumsum(steps)))


def places_along(line: AnyArray, x: Counts, y: Counts) -> Float64:
    """Return the distance along a line of the position nearest to each point, in counts.

    Results are those of `shapely.line_locate_point`, which needs an object for each point.
    """
    ends = line[:, :2].astype(np.float64)
    steps = np.diff(ends, axis=0)
    squares = (steps**2).sum(axis=1)
    lengths = np.concatenate(([0.0], np.cumsum(np.sqrt(squares))))
    segments = np.column_stack((ends[:-1], steps, squares, lengths[:-1]))[squares > 0]
    along = np.zeros(x.shape)
    for first in range(0, x.size, POINTS_AT_ONCE):
        part = slice(first, first + POINTS_AT_ONCE)
        along[part] = _nearest_along(
            segments, x[part].astype(np.float64), y[part].astype(np.float64)
        )
    return along


def _nearest_along(segments: Float64, x: Float64, y: Float64) -> Float64:
    """Return `places_along` for a few points.

    The columns of ``segments`` are x and y of the start, x and y from there to the end, the
    square of the length, and the distance of the start along the line.
    """
    low_x, high_x, low_y, high_y = x.min(), x.max(), y.min(), y.max()
    middle = (low_x + high_x) / 2, (low_y + high_y) / 2
    far, _ = _from_segment(segments.T, *middle)
    # Farther segments are not nearest to any of the points.
    near = far <= far.min(initial=np.inf) + math.hypot(high_x - low_x, high_y - low_y) + 1
    nearest, along = np.full(x.shape, np.inf), np.zeros(x.shape)
    for segment in segments[near]:
        distance, share = _from_segment(segment, x, y)
        is_nearer = distance < nearest
        np.copyto(nearest, distance, where=is_nearer)
        np.copyto(along, segment[5] + share * math.sqrt(segment[4]), where=is_nearer)
    return along


def _from_segment(segment: Float64, x: Any, y: Any) -> tuple[Float64, Float64]:
    """Return the distance of points from a segment, and the share of the segment before the nearest position.

    Pass many points and one segment, or one point and many segments.
    """
    x0, y0, dx, dy, square, _ = segment
    from_x, from_y = x - x0, y - y0
    share = (from_x * dx + from_y * dy) / square
    aside = np.abs((from_x * dy - from_y * dx) / square) * np.sqrt(square)
    end_x, end_y = (
        np.where(share < 1, from_x, x - (x0 + dx)),
        np.where(share < 1, from_y, y - (y0 + dy)),
    )
    is_beside = (share > 0) & (share < 1)
    distance = np.where(is_beside, aside, np.sqrt(end_x * end_x + end_y * end_y))
    return distance, np.minimum(np.maximum(share, 0.0), 1.0)


def lifted_line(line: AnyArray, places: AnyArray, heights: AnyArray) -> Counts:
    """Return a line with heights, which are interpolated between known heights along it.

    Parameters
    ----------
    line : shape (n, 2)
        Vertices of the line, in absolute counts.
    places : shape (m,)
        Distances of the known heights from the start of the line, ascending, in counts.
    heights : shape (m,)
        Known heights, in counts.

    Returns
    -------
    int64, shape (k, 3)
        Vertices of the line and positions of the known heights, each once.
    """
    lengths = lengths_along(line)
    every = np.unique(np.concatenate((lengths, places.clip(0, lengths[-1]))))
    xy = [np.interp(every, lengths, line[:, axis]) for axis in (0, 1)]
    vertices = np.rint(np.stack((*xy, np.interp(every, places, heights)), axis=1)).astype(
        np.int64
    )
    moved = np.concatenate(([True], (np.diff(vertices[:, :2], axis=0) != 0).any(axis=1)))
    return np.asarray(vertices[moved])


@dataclass(frozen=True, eq=False)
class Waters:
    """Bodies of water with known heights. Where bodies overlap, the last one applies."""

    bodies: tuple[Water, ...]

    @cached_property
    def key(self) -> str:
        """Digest of all bodies."""
        text = json.dumps([[body.number, *body.digest] for body in self.bodies])
        return digest_of_bytes(text.encode())

    @property
    def stored_key(self) -> str | None:
        """Key of the bodies in the store, or None if there are none."""
        return self.key if self.bodies else None

    @cached_property
    def index(self) -> AreaIndex:
        """Spatial index of the bodies."""
        return AreaIndex([body.area for body in self.bodies])

    def near(self, bounds: Bounds) -> Waters:
        """Return the bodies that touch the bounds."""
        return replace(self, bodies=tuple(self.bodies[i] for i in self.index.touching(bounds)))

    def digest(self, bounds: Bounds) -> list[Any]:
        """Return the values on which results within the bounds depend."""
        return [body.digest for body in self.near(bounds).bodies]

    def levels(self, x: Counts, y: Counts) -> Float64:
        """Return the levels at positions in absolute counts, in whole counts, -inf where there is no water."""
        levels = np.full(x.shape, -np.inf)
        for body in self.bodies:
            inside = np.flatnonzero(body.area.inside(x, y))
            levels[inside] = body.heights(x[inside], y[inside])
        return levels

    def inside(self, spec: RasterSpec, block: Block) -> Bool:
        """Return the mask of the pixels of a block that are water."""
        is_water = np.zeros((block.height, block.width), np.bool_)
        for body in self.bodies:
            part = spec.part(block, body.area.bounds)
            is_water[within(part, block)] |= spec.inside(part, body.area)
        return is_water

    def set_heights(
        self, spec: RasterSpec, block: Block, heights: Float32, where: Bool
    ) -> list[tuple[str, int]]:
        """Set the heights of the water's pixels in the mask ``where``, in units of the CRS.

        Returns
        -------
        list of tuple of str and int
            Key of the area and number of pixels of each body.
        """
        pixel_counts = []
        for body in self.bodies:
            part = spec.part(block, body.area.bounds)
            pixels = within(part, block)
            inside = spec.inside(part, body.area) & where[pixels]
            x, y = spec.centres(part)
            heights[pixels][inside] = body.heights(x[inside], y[inside]) / COUNTS_PER_UNIT
            pixel_counts.append((body.area.key, int(inside.sum())))
        return pixel_counts

    def to_json(self) -> list[dict[str, Any]]:
        """Return a JSON-able description, which `from_json` reads."""
        return [body.to_json() for body in self.bodies]

    @classmethod
    def from_json(cls, data: Sequence[Mapping[str, Any]]) -> Waters:
        """Return the waters that `to_json` described."""
        return cls(tuple(Water.from_json(body) for body in data))
