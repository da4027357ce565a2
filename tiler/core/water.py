"""Standing and running water: polygons in which the terrain is level, or falls along a line."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from tiler.core.area import Area
from tiler.core.area_index import AreaIndex
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Bounds
from tiler.core.raster import Block, RasterSpec, within

Counts = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

LAKE, RIVER = "lake", "river"
KINDS = {
    LAKE: LAKE, "pond": LAKE, "reservoir": LAKE, "basin": LAKE, "sea": LAKE, "lagoon": LAKE,
    RIVER: RIVER, "stream": RIVER, "canal": RIVER, "ditch": RIVER,
}  # fmt: skip
"""Kinds as files name them, and whether each is level as a lake or falls as a river."""


class Station(NamedTuple):
    """A place along a river where its level was estimated, in absolute counts.

    Attributes
    ----------
    x, y : int
    level : int
        Of the water.
    seen : int
        Pixels of the water itself that the level rests on; 0 where it rests on the banks.
    left, right : int or None
        Level that the bank on that side would give, looking downstream; None where it was not seen.
    """

    x: int
    y: int
    level: int
    seen: int
    left: int | None
    right: int | None


@dataclass(frozen=True, eq=False)
class Water:
    """A body of water.

    Attributes
    ----------
    number : int
        From 1 on.
    kind : str
        `LAKE` or `RIVER`.
    area : Area
    level : int or None
        Counts of the height of a lake, and of a river without a line; None while it is not known.
    flow : int64 (n, 2 or 3) or None
        Line of a river in absolute counts: x, y, and the height of the water once it is known, which falls or stays
        from each vertex to the next. A place of the river has the height of the nearest place of the line.
    sure : float or None
        How sure it is that this is water, 0 to 1; None where a person said so.
    stations : tuple of Station
        What the heights of a river without given ones rest on, downstream.
    """

    number: int
    kind: str
    area: Area
    level: int | None = None
    flow: Counts | None = None
    sure: float | None = None
    stations: tuple[Station, ...] = ()

    @property
    def levelled(self) -> bool:
        """Whether its heights are known."""
        return self.level is not None or (self.flow is not None and self.flow.shape[1] == 3)

    @property
    def range(self) -> tuple[float, float]:
        """Highest and lowest level, in units of the CRS."""
        z = [self.level] if self.level is not None or self.flow is None else self.flow[:, 2].tolist()
        return max(z) / COUNTS_PER_UNIT, min(z) / COUNTS_PER_UNIT

    @cached_property
    def digest(self) -> list[Any]:
        """What a result depends on."""
        flow = None if self.flow is None else self.flow.tolist()
        return [self.kind, self.area.key, self.level, flow, [list(station) for station in self.stations]]

    def heights(self, x: Counts, y: Counts) -> npt.NDArray[np.float64]:
        """Levels at places in absolute counts, whole counts."""
        if self.level is not None or self.flow is None:
            return np.full(x.shape, float(self.level or 0))
        import shapely

        line, z = shapely.LineString(self.flow[:, :2]), self.flow[:, 2]
        along = shapely.line_locate_point(line, shapely.points(x, y))
        heights: npt.NDArray[np.float64] = np.rint(np.interp(along, lengths_along(self.flow), z))
        return heights

    def to_json(self) -> dict[str, Any]:
        """A JSON-able description; `from_json` reads it back."""
        flow = None if self.flow is None else self.flow.tolist()
        return {
            "number": self.number, "kind": self.kind, "rings": self.area.to_json(), "level": self.level,
            "flow": flow, "sure": self.sure, "stations": [list(station) for station in self.stations],
        }  # fmt: skip

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Water:
        """The water that `to_json` described."""
        flow = None if data["flow"] is None else np.array(data["flow"], np.int64)
        area = Area.from_json(data["rings"])
        stations = tuple(Station(*station) for station in data["stations"])
        return cls(data["number"], data["kind"], area, data["level"], flow, data["sure"], stations)


def lengths_along(line: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Length of a line up to each vertex, in counts."""
    steps = np.hypot(*np.diff(line[:, :2].astype(np.float64), axis=0).T)
    return np.concatenate(([0.0], np.cumsum(steps)))


def lifted_line(line: npt.NDArray[Any], places: npt.NDArray[Any], heights: npt.NDArray[Any]) -> Counts:
    """A line with heights that are known at places along it.

    Parameters
    ----------
    line : shape (n, 2)
        Absolute counts.
    places, heights : shape (m,)
        Counts from the start of the line, ascending, and counts of height.

    Returns
    -------
    int64, shape (k, 3)
        The vertices of the line and the places, each once.
    """
    lengths = lengths_along(line)
    every = np.unique(np.concatenate((lengths, places.clip(0, lengths[-1]))))
    xy = [np.interp(every, lengths, line[:, axis]) for axis in (0, 1)]
    found = np.rint(np.stack((*xy, np.interp(every, places, heights)), axis=1)).astype(np.int64)
    moved = np.concatenate(([True], (np.diff(found[:, :2], axis=0) != 0).any(axis=1)))
    return np.asarray(found[moved])


@dataclass(frozen=True, eq=False)
class Waters:
    """Bodies of water with known heights; where they overlap, the last one holds."""

    bodies: tuple[Water, ...]

    @cached_property
    def key(self) -> str:
        """A digest of them all."""
        text = json.dumps([[body.number, *body.digest] for body in self.bodies])
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    @cached_property
    def index(self) -> AreaIndex:
        """Finds those near a place."""
        return AreaIndex([body.area for body in self.bodies])

    def near(self, bounds: Bounds) -> Waters:
        """Bodies that touch the bounds."""
        return replace(self, bodies=tuple(self.bodies[i] for i in self.index.touching(bounds)))

    def digest(self, bounds: Bounds) -> list[Any]:
        """What results within some bounds depend on."""
        return [body.digest for body in self.near(bounds).bodies]

    def holds(self, x: Counts, y: Counts) -> Bools:
        """Mask of the places, absolute counts, that are water."""
        found = np.zeros(x.shape, np.bool_)
        for body in self.bodies:
            found |= body.area.inside(x, y)
        return found

    def reaches(self, xyz: Counts, above: float) -> Bools:
        """Mask of points, absolute counts of shape (3, n), in the water or up to ``above`` counts over its level."""
        x, y, z = xyz
        found = np.zeros(x.shape, np.bool_)
        for body in self.bodies:
            inside = np.flatnonzero(body.area.inside(x, y))
            levels = body.heights(x[inside], y[inside])
            found[inside] = z[inside] <= levels + above
        return found

    def inside(self, spec: RasterSpec, block: Block) -> Bools:
        """Mask of the pixels of a block that are water."""
        found = np.zeros((block.height, block.width), np.bool_)
        for body in self.bodies:
            part = spec.part(block, body.area.bounds)
            found[within(part, block)] |= spec.inside(part, body.area)
        return found

    def set_heights(
        self, spec: RasterSpec, block: Block, heights: npt.NDArray[np.float32], where: Bools
    ) -> list[tuple[str, int]]:
        """Set the heights of the water's pixels, units of the CRS; key of each area, and its pixels."""
        found = []
        for body in self.bodies:
            part = spec.part(block, body.area.bounds)
            pixels = within(part, block)
            inside = spec.inside(part, body.area) & where[pixels]
            x, y = spec.centres(part)
            heights[pixels][inside] = body.heights(x[inside], y[inside]) / COUNTS_PER_UNIT
            found.append((body.area.key, int(inside.sum())))
        return found

    def to_json(self) -> list[dict[str, Any]]:
        """A JSON-able description; `from_json` reads it back."""
        return [body.to_json() for body in self.bodies]

    @classmethod
    def from_json(cls, data: list[dict[str, Any]]) -> Waters:
        """The waters that `to_json` described."""
        return cls(tuple(Water.from_json(body) for body in data))
