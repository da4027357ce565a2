"""Edits that a user draws: polygons that set the class of points or the height of the terrain."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ptd.arrays import Bool, Float32, Indices, Int8, Int32, Int64, UInt8
from tiler.core.area import Area, AreaIndex, Places
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds, Cell, Lattice
from tiler.core.points import (
    BRIDGE,
    GROUND,
    NOISE,
    UNCERTIFIED_BIT,
    UNCLASSIFIED,
    UNSEEN_FLAGS,
    WATER,
    PointBlock,
)
from tiler.core.raster import NODATA, Block, RasterSpec, within
from tiler.core.records import digest_of_bytes

NOT_GROUND = "not_ground"
TO_GROUND = "ground"
VOID = "void"
FLAT = "flat"
ACTIONS = (NOT_GROUND, TO_GROUND, VOID, FLAT)
"""Actions that a user can request."""
DECK = "deck"
"""Action of an edit that tiler makes itself, for the deck of a bridge that it found."""
DrawnDeck = tuple[tuple[int, ...], float, float, float, int]
"""Outline as x, y, x, y, ... in counts, length, width and clearance in metres, and number of
points below the deck."""
OF_POINTS = (NOT_GROUND, TO_GROUND, DECK)
"""Actions that change the class of points."""
OF_PIXELS = (VOID, FLAT)
"""Actions that change the height of pixels."""

# The edits make one of these decisions about each point.
UNTOUCHED = -1
FORCED_OFF = 0
FORCED_ON = 1
FORCED_BRIDGE = 2

Classes = UInt8
Rows = Indices


@dataclass(frozen=True)
class DeckSurface:
    """Surface of a deck, in counts.

    Its height is a + b s + c s^2 + d t at the position (x, y) + s (ux, uy) + t (-uy, ux). A
    point of the deck may lie up to ``low`` counts below the surface and up to ``high`` counts
    above it.
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

    def holds(self, x: Int64, y: Int64, z: Int32) -> Bool:
        """Return the mask of the points that are as high as the deck."""
        dx = x - self.x
        dy = y - self.y
        s = dx * self.ux + dy * self.uy
        t = dy * self.ux - dx * self.uy
        off = z - (self.a + self.b * s + self.c * s * s + self.d * t)
        is_on_deck: Bool = (off >= -self.low) & (off <= self.high)
        return is_on_deck


@dataclass(frozen=True, eq=False)
class Edit:
    """Polygons of one feature and the action inside them.

    Attributes
    ----------
    number : int
        Number of the feature in its file. The first is 1.
    action : str
        One of `ACTIONS`, or `DECK`.
    area : Area
        Polygons of the feature.
    z : int or None
        Height that `FLAT` sets, in counts.
    lowest : bool
        Whether `TO_GROUND` selects the lowest point of each cell, because the input has no ground inside.
    deck : DeckSurface or None
        Surface of the deck, only for `DECK`.
    """

    number: int
    action: str
    area: Area
    z: int | None = None
    lowest: bool = False
    deck: DeckSurface | None = None

    @cached_property
    def key(self) -> str:
        """Digest by which records name the edit, since its number in the file may change."""
        return digest_of_bytes(json.dumps([self.action, self.area.key, self.z]).encode())

    @cached_property
    def digest(self) -> list[Any]:
        """Values on which results depend."""
        values: list[Any] = [self.key, self.lowest]
        if self.deck is not None:
            values += astuple(self.deck)
        return values

    def to_json(self) -> dict[str, Any]:
        """Return a JSON-able description, which `from_json` reads."""
        return {
            "number": self.number,
            "action": self.action,
            "rings": self.area.to_json(),
            "z": self.z,
            "lowest": self.lowest,
            "deck": None if self.deck is None else list(astuple(self.deck)),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Edit:
        """Return the edit that `to_json` described."""
        return cls(
            number=data["number"],
            action=data["action"],
            area=Area.from_json(data["rings"]),
            z=data["z"],
            lowest=data["lowest"],
            deck=DeckSurface(*data["deck"]) if data.get("deck") else None,
        )


@dataclass(frozen=True, eq=False)
class Edits:
    """Edits in the order of their file. If two edits overlap, the later one applies.

    Attributes
    ----------
    edits : tuple of Edit
    cell : Lattice
        Lattice of the cells in which `TO_GROUND` selects the lowest point.
    """

    edits: tuple[Edit, ...]
    cell: Lattice

    @cached_property
    def key(self) -> str:
        """Digest of all edits."""
        text = json.dumps(
            [self.cell.to_json(), *([edit.number, *edit.digest] for edit in self.edits)]
        )
        return digest_of_bytes(text.encode())

    @cached_property
    def _index(self) -> AreaIndex:
        return AreaIndex([edit.area for edit in self.edits])

    def near(self, bounds: Bounds, actions: Iterable[str]) -> Edits:
        """Return the edits that have one of the actions and touch the bounds."""
        touching = (self.edits[i] for i in self._index.touching(bounds))
        return replace(self, edits=tuple(edit for edit in touching if edit.action in actions))

    def by_cell(self, lattice: Lattice, cells: Iterable[Cell]) -> dict[Cell, list[Edit]]:
        """Return the edits that change points and touch each cell. Cells without such edits are left out."""
        edits_by_cell = {}
        for cell, near in self._index.by_cell(lattice, cells).items():
            edits = [self.edits[i] for i in near if self.edits[i].action in OF_POINTS]
            if edits:
                edits_by_cell[cell] = edits
        return edits_by_cell

    def digest(self, bounds: Bounds, actions: Iterable[str]) -> list[Any]:
        """Return the values on which results inside the bounds depend. They are empty if no edit touches the bounds."""
        edits_near = self.near(bounds, actions).edits
        if not edits_near:
            return []
        return [self.cell.to_json(), *(edit.digest for edit in edits_near)]

    def forced(self, block: PointBlock, classes: Classes, origin: tuple[int, int]) -> Int8:
        """Decide for each point of a bucket: `UNTOUCHED`, `FORCED_OFF`, `FORCED_ON` or `FORCED_BRIDGE`.

        Parameters
        ----------
        block : PointBlock
            Points with the flags and classes of the input.
        classes : uint8 (n,)
            Classes without edits, with or without `UNCERTIFIED_BIT`.
        origin : tuple of int
            Absolute counts of the local count 0.
        """
        decisions = np.full(len(classes), UNTOUCHED, np.int8)
        points = EditedPoints(block, classes, origin)
        for edit in self.edits:
            rows = points.inside(edit.area)
            if edit.action == NOT_GROUND:
                decisions[rows] = FORCED_OFF
            elif edit.deck is not None:
                decisions[points.on_deck(rows, edit.deck)] = FORCED_BRIDGE
            elif edit.action == TO_GROUND:
                decisions[points.to_ground(rows, self.cell if edit.lowest else None)] = (
                    FORCED_ON
                )
        return decisions

    def labels(self, block: PointBlock, labels: Classes, origin: tuple[int, int]) -> Classes:
        """Return the labels of a bucket's points after the edits."""
        forced = self.forced(block, labels, origin)
        classes = labels & ~np.uint8(UNCERTIFIED_BIT)
        edited = labels.copy()
        edited[(forced == FORCED_OFF) & (classes == GROUND)] = UNCLASSIFIED
        edited[(forced == FORCED_BRIDGE) & np.isin(classes, (GROUND, UNCLASSIFIED))] = BRIDGE
        edited[forced == FORCED_ON] = GROUND
        return edited

    def set_heights(
        self, spec: RasterSpec, block: Block, heights: Float32
    ) -> list[tuple[str, int]]:
        """Set the heights of a block's pixels, in units of the CRS.

        Returns
        -------
        list of (str, int)
            Key of each edit, and number of pixels that it changed.
        """
        changed = []
        for edit in self.edits:
            if edit.action not in OF_PIXELS:
                continue
            z = np.float32(NODATA if edit.z is None else edit.z / COUNTS_PER_UNIT)
            part = spec.part(block, edit.area.bounds)
            pixels = heights[within(part, block)]
            inside = spec.inside(part, edit.area) & (pixels != z)
            pixels[inside] = z
            changed.append((edit.key, int(inside.sum())))
        return changed

    def to_json(self) -> dict[str, Any]:
        """Return a JSON-able description, which `from_json` reads."""
        return {"cell": self.cell.to_json(), "edits": [edit.to_json() for edit in self.edits]}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Edits:
        """Return the edits that `to_json` described."""
        return cls(
            tuple(Edit.from_json(e) for e in data["edits"]), Lattice.from_json(data["cell"])
        )


class EditedPoints:
    """Points of a bucket, prepared for queries of many edits.

    Parameters
    ----------
    block : PointBlock
        Points with the flags and classes of the input.
    classes : uint8 (n,)
        Classes without edits, with or without `UNCERTIFIED_BIT`.
    origin : tuple of int
        Absolute counts of the local count 0.
    """

    def __init__(self, block: PointBlock, classes: Classes, origin: tuple[int, int]) -> None:
        self._block = block
        self._classes = classes
        self._x = block.xyz[0].astype(np.int64) + origin[0]
        self._y = block.xyz[1].astype(np.int64) + origin[1]

    @cached_property
    def _places(self) -> Places:
        return Places(self._x, self._y)

    @cached_property
    def _can_be_ground(self) -> Bool:
        return can_be_ground(self._block, self._classes)

    def inside(self, area: Area) -> Rows:
        """Return the rows of the points inside an area, ascending."""
        return self._places.inside(area)

    def on_deck(self, rows: Rows, deck: DeckSurface) -> Rows:
        """Return the ``rows`` whose points are as high as a deck."""
        return rows[deck.holds(self._x[rows], self._y[rows], self._block.xyz[2][rows])]

    def to_ground(self, rows: Rows, cell: Lattice | None) -> Rows:
        """Return the ``rows`` that become ground.

        These are the lowest point of each cell, or without ``cell`` the ground of the input.
        """
        rows = rows[self._can_be_ground[rows]]
        if cell is None:
            given = self._block.classification
            return rows if given is None else rows[given[rows] == GROUND]
        lowest = _lowest(self._x[rows], self._y[rows], self._block.xyz[2][rows], cell)
        return rows[lowest]


def ground_with(is_ground: Bool, forced: Int8) -> Bool:
    """Return the mask of the points that are ground after the edits."""
    is_ground_after: Bool = (is_ground & (forced == UNTOUCHED)) | (forced == FORCED_ON)
    return is_ground_after


def can_be_ground(block: PointBlock, classes: Classes) -> Bool:
    """Return the mask of the points that may become ground.

    These points take part in the run, and are not noise, water or bridge in the input or in
    ``classes``.
    """
    excluded = (*NOISE, WATER, BRIDGE)
    if block.flags is None or block.classification is None:
        raise ValueError("block: flags or classification is None; read both columns")
    may_be_ground: Bool = (block.flags & UNSEEN_FLAGS) == 0
    may_be_ground &= ~np.isin(classes & ~np.uint8(UNCERTIFIED_BIT), excluded)
    may_be_ground &= ~np.isin(block.classification, excluded)
    return may_be_ground


def _lowest(x: Int64, y: Int64, z: Int32, cell: Lattice) -> Rows:
    """Return the indices of the lowest point of each cell. Of equally low points, it is the first by (x, y)."""
    ix, iy = cell.index(x), cell.index(y)
    order = np.lexsort((y, x, z, ix, iy))
    first = np.ones(len(order), np.bool_)
    first[1:] = (np.diff(ix[order]) != 0) | (np.diff(iy[order]) != 0)
    return order[first]
