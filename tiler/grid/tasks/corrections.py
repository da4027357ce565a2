"""Edits and breaklines of a run, and what they add to the digests of tasks.

A correction changes only the digests of the buckets and blocks that it can affect. No others
are processed again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from tiler.core.breaklines import Breaklines
from tiler.core.edits import DrawnDeck, Edits
from tiler.core.lattice import Bounds, Cell
from tiler.grid.block import full_halo
from tiler.plan import Plan


@dataclass(frozen=True)
class Corrections:
    """Edits and breaklines of a run, applied on top of the labels.

    Attributes
    ----------
    edits : Edits or None
    lines : Breaklines or None
    line_digests : mapping of Cell to str
        Digest of the breaklines in each bucket, even if the bucket has no points.
    decks : tuple of DrawnDeck
        Decks of bridges. ``edits`` remove the points of these decks from the terrain.
    """

    edits: Edits | None = None
    lines: Breaklines | None = None
    line_digests: Mapping[Cell, str] = field(default_factory=dict)
    decks: tuple[DrawnDeck, ...] = ()

    @property
    def edits_key(self) -> str | None:
        """Key in the store of the edits, or None if there are none."""
        return None if self.edits is None else self.edits.key

    @property
    def lines_key(self) -> str | None:
        """Key in the store of the breaklines, or None if there are none."""
        return None if self.lines is None else self.lines.key

    def edit_digests(self, extent: Bounds, actions: Sequence[str]) -> list[Any]:
        """Return the values of the edits with some actions within an extent, for digests."""
        return [] if self.edits is None else self.edits.digest(extent, actions)

    def line_digests_near(self, extent: Bounds, plan: Plan) -> list[Any]:
        """Return column, row and digest of the buckets whose breaklines can change facets within an extent."""
        counts, lattice = plan.frame.counts, plan.buckets
        facet_reach = full_halo(counts(plan.config.max_edge))
        facet_reach += math.ceil(3 * counts(plan.grid.resolution))
        near = lattice.among(extent.pad(facet_reach), self.line_digests)
        return [[cell.ix, cell.iy, self.line_digests[cell]] for cell in near]
