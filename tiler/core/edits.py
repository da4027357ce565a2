"""Corrections that a person drew: polygons that say which points are ground, or what height the terrain has."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import astuple, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.core.area import Area
from tiler.core.classes import BRIDGE, GROUND, MARK_BIT, NOISE, UNCLASSIFIED, WATER, WITHHELD_FLAG
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Bounds, Lattice
from tiler.core.points import PointBlock
from tiler.core.raster import NODATA, Block, RasterSpec

NOT_GROUND, TO_GROUND, VOID, FLAT = "not_ground", "ground", "void", "flat"
ACTIONS = (NOT_GROUND, TO_GROUND, VOID, FLAT)
DECK = "deck"
"""In place of an action that a person asks for: points on the deck of a bridge that was found."""
OF_POINTS, OF_PIXELS = (NOT_GROUND, TO_GROUND, DECK), (VOID, FLAT)
"""Those that say what points are, and those that say what the terrain holds."""

UNTOUCHED, FORCED_OFF, FORCED_ON, FORCED_BRIDGE = -1, 0, 1, 2
"""What edits say of a point: nothing, not ground, ground, bridge."""

Int8 = npt.NDArray[np.int8]
Classes = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class DeckSurface:
    """Height of a deck: a + b s + c s^2 + d t, of the places (x, y) + s (ux, uy) + t (-uy, ux); all of it in counts.

    ``low``, ``high``: counts by which a point of it may lie below and above.
    """

    x: float
    y: float
    ux: float
    uy: float
    a: float
    b: float
    c: float
    d: float
    low: float
    high: float

    def holds(
        self, x: npt.NDArray[np.int64], y: npt.NDArray[np.int64], z: npt.NDArray[np.int32]
    ) -> npt.NDArray[np.bool_]:
        """Which points are as high as the deck."""
        dx, dy = x - self.x, y - self.y
        s, t = dx * self.ux + dy * self.uy, dy * self.ux - dx * self.uy
        off = z - (self.a + self.b * s + self.c * s * s + self.d * t)
        found: npt.NDArray[np.bool_] = (off >= -self.low) & (off <= self.high)
        return found


@dataclass(frozen=True, eq=False)
class Edit:
    """One polygon, or several of one feature, and what is done inside.

    Attributes
    ----------
    number : int
        Of the feature in its file, from 1 on.
    action : str
        One of `ACTIONS`.
    z : int or None
        Counts of the height of `FLAT`.
    lowest : bool
        `TO_GROUND` takes the lowest point of each cell, as the input calls none inside ground.
    deck : DeckSurface or None
        Of `DECK`.
    """

    number: int
    action: str
    area: Area
    z: int | None = None
    lowest: bool = False
    deck: DeckSurface | None = None

    @cached_property
    def digest(self) -> list[Any]:
        """What a result depends on."""
        deck = [] if self.deck is None else list(astuple(self.deck))
        return [self.action, self.area.key, self.z, self.lowest, *deck]

    def to_json(self) -> dict[str, Any]:
        """A JSON-able description."""
        return {
            "number": self.number,
            "action": self.action,
            "rings": self.area.to_json(),
            "z": self.z,
            "lowest": self.lowest,
            "deck": None if self.deck is None else list(astuple(self.deck)),
        }

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Edit:
        """The edit that `to_json` described."""
        deck = None if data.get("deck") is None else DeckSurface(*data["deck"])
        area = Area.from_json(data["rings"])
        return cls(data["number"], data["action"], area, data["z"], data["lowest"], deck)


@dataclass(frozen=True, eq=False)
class Edits:
    """Edits in the order of their file; where they overlap, the last one holds.

    Attributes
    ----------
    cell : Lattice
        `TO_GROUND` takes the lowest point of each of its cells, where it takes lowest points.
    """

    edits: tuple[Edit, ...]
    cell: Lattice

    @cached_property
    def key(self) -> str:
        """A digest of them all."""
        text = json.dumps([self.cell.to_json(), *([edit.number, *edit.digest] for edit in self.edits)])
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    def near(self, bounds: Bounds, actions: Iterable[str]) -> Edits:
        """Those of some actions that touch the bounds."""
        found = (e for e in self.edits if e.action in actions and e.area.bounds.overlaps(bounds))
        return replace(self, edits=tuple(e for e in found if e.area.touches(bounds)))

    def digest(self, bounds: Bounds, actions: Iterable[str]) -> list[Any]:
        """What results within some bounds depend on; empty where no edit touches them."""
        found = self.near(bounds, actions).edits
        return [self.cell.to_json(), *(edit.digest for edit in found)] if found else []

    def forced(self, block: PointBlock, classes: Classes, origin: tuple[int, int]) -> Int8:
        """What the edits say of each point of a bucket: `UNTOUCHED`, `FORCED_OFF` or `FORCED_ON`.

        Parameters
        ----------
        block : PointBlock
            With flags and the input's classes.
        classes : uint8 (n,)
            As they are without edits, with or without `MARK_BIT`.
        """
        found = np.full(len(classes), UNTOUCHED, np.int8)
        x, y = (block.xyz[axis].astype(np.int64) + origin[axis] for axis in (0, 1))
        for edit in self.edits:
            inside = edit.area.inside(x, y)
            if edit.action == NOT_GROUND:
                found[inside] = FORCED_OFF
            elif edit.deck is not None:
                found[inside & edit.deck.holds(x, y, block.xyz[2])] = FORCED_BRIDGE
            elif edit.action == TO_GROUND and inside.any():
                possible = inside & can_be_ground(block, classes)
                rows = np.flatnonzero(
                    possible if edit.lowest else possible & (block.classification == GROUND)
                )
                if edit.lowest:
                    rows = rows[_lowest(x[rows], y[rows], block.xyz[2][rows], self.cell)]
                found[rows] = FORCED_ON
        return found

    def labels(self, block: PointBlock, labels: Classes, origin: tuple[int, int]) -> Classes:
        """Labels of the points of a bucket as the edits want them."""
        forced = self.forced(block, labels, origin)
        found = labels & ~np.uint8(MARK_BIT)
        off = (forced == FORCED_OFF) & (found == GROUND)
        bridge = (forced == FORCED_BRIDGE) & np.isin(found, (GROUND, UNCLASSIFIED))
        labels = np.where(bridge, np.uint8(BRIDGE), np.where(off, np.uint8(UNCLASSIFIED), labels))
        return np.where(forced == FORCED_ON, np.uint8(GROUND), labels)

    def set_heights(
        self, spec: RasterSpec, block: Block, heights: npt.NDArray[np.float32]
    ) -> list[tuple[int, int]]:
        """Set the heights of a block's pixels, in units of the CRS; number of each edit and how many it changed."""
        changed = []
        for edit in self.edits:
            if edit.action in OF_PIXELS:
                z = np.float32(NODATA if edit.z is None else edit.z / COUNTS_PER_UNIT)
                inside = spec.inside(block, edit.area) & (heights != z)
                heights[inside] = z
                changed.append((edit.number, int(inside.sum())))
        return changed

    def to_json(self) -> dict[str, Any]:
        """A JSON-able description; `from_json` reads it back."""
        return {"cell": self.cell.to_json(), "edits": [edit.to_json() for edit in self.edits]}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Edits:
        """The edits that `to_json` described."""
        return cls(tuple(Edit.from_json(e) for e in data["edits"]), Lattice.from_json(data["cell"]))


def ground_with(is_ground: npt.NDArray[np.bool_], forced: Int8) -> npt.NDArray[np.bool_]:
    """Which points are ground after the edits."""
    found: npt.NDArray[np.bool_] = (is_ground & (forced == UNTOUCHED)) | (forced == FORCED_ON)
    return found


def can_be_ground(block: PointBlock, classes: Classes) -> npt.NDArray[np.bool_]:
    """Points that are not noise, water or bridge by the input or now, and not withheld."""
    none = (*NOISE, WATER, BRIDGE)
    if block.flags is None or block.classification is None:
        raise ValueError("needs the flags and classes of the points")
    found: npt.NDArray[np.bool_] = (block.flags & WITHHELD_FLAG) == 0
    found &= ~np.isin(classes & ~np.uint8(MARK_BIT), none) & ~np.isin(block.classification, none)
    return found


def _lowest(
    x: npt.NDArray[np.int64], y: npt.NDArray[np.int64], z: npt.NDArray[np.int32], cell: Lattice
) -> Any:
    """Indices of the lowest point of each cell; ties by (x, y)."""
    ix, iy = cell.index(x), cell.index(y)
    order = np.lexsort((y, x, z, ix, iy))
    first = np.ones(len(order), np.bool_)
    first[1:] = (np.diff(ix[order]) != 0) | (np.diff(iy[order]) != 0)
    return order[first]
