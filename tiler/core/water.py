"""Standing and running water: polygons in which the terrain is level, or falls along a line."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.core.area import Area
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Bounds
from tiler.core.raster import Block, RasterSpec

Counts = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

LAKE, RIVER = "lake", "river"
KINDS = {
    LAKE: LAKE, "pond": LAKE, "reservoir": LAKE, "basin": LAKE, "sea": LAKE, "lagoon": LAKE,
    RIVER: RIVER, "stream": RIVER, "canal": RIVER, "ditch": RIVER,
}  # fmt: skip
"""Kinds as files name them, and whether each is level as a lake or falls as a river."""


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
    """

    number: int
    kind: str
    area: Area
    level: int | None = None
    flow: Counts | None = None
    sure: float | None = None

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
        return [self.kind, self.area.key, self.level, None if self.flow is None else self.flow.tolist()]

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
            "flow": flow, "sure": self.sure,
        }  # fmt: skip

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Water:
        """The water that `to_json` described."""
        flow = None if data["flow"] is None else np.array(data["flow"], np.int64)
        area = Area.from_json(data["rings"])
        return cls(data["number"], data["kind"], area, data["level"], flow, data["sure"])


def lengths_along(line: Counts) -> npt.NDArray[np.float64]:
    """Length of a line up to each vertex, in counts."""
    steps = np.hypot(*np.diff(line[:, :2].astype(np.float64), axis=0).T)
    return np.concatenate(([0.0], np.cumsum(steps)))


@dataclass(frozen=True, eq=False)
class Waters:
    """Bodies of water with known heights; where they overlap, the last one holds."""

    bodies: tuple[Water, ...]

    @cached_property
    def key(self) -> str:
        """A digest of them all."""
        text = json.dumps([[body.number, *body.digest] for body in self.bodies])
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    def near(self, bounds: Bounds) -> Waters:
        """Those that touch the bounds."""
        found = (b for b in self.bodies if b.area.bounds.overlaps(bounds) and b.area.touches(bounds))
        return replace(self, bodies=tuple(found))

    def digest(self, bounds: Bounds) -> list[Any]:
        """What results within some bounds depend on."""
        return [body.digest for body in self.near(bounds).bodies]

    def inside(self, spec: RasterSpec, block: Block) -> Bools:
        """Mask of the pixels of a block that are water."""
        found = np.zeros((block.height, block.width), np.bool_)
        for body in self.bodies:
            found |= spec.inside(block, body.area)
        return found

    def set_heights(
        self, spec: RasterSpec, block: Block, heights: npt.NDArray[np.float32], where: Bools
    ) -> list[tuple[int, int]]:
        """Set the heights of the water's pixels, units of the CRS; number of each body and how many pixels it has."""
        found = []
        for body in self.bodies:
            inside = spec.inside(block, body.area) & where
            x, y = spec.centres(block)
            heights[inside] = body.heights(x[inside], y[inside]) / COUNTS_PER_UNIT
            found.append((body.number, int(inside.sum())))
        return found

    def to_json(self) -> list[dict[str, Any]]:
        """A JSON-able description; `from_json` reads it back."""
        return [body.to_json() for body in self.bodies]

    @classmethod
    def from_json(cls, data: list[dict[str, Any]]) -> Waters:
        """The waters that `to_json` described."""
        return cls(tuple(Water.from_json(body) for body in data))
