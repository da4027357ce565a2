"""Arguments of the task of a tile: the pass, the buckets that it labels, and what it reads and writes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.schedule import NOT_IN_DIGEST


@dataclass(frozen=True)
class FilterTile:
    """One tile of a pass: the arguments of `tiler.filter.filter_tile`.

    Attributes
    ----------
    method : str
    parameters : mapping
        Of the method, as JSON.
    number : int
        Of the pass, from 0.
    state : mapping
        Of the passes before.
    cells : tuple of Cell
        The buckets of the core.
    halo, max_halo : int
        Counts, to begin with and at most.
    keep_classes, skip_flags
        What takes no part, see `tiler.core.classes.participates`.
    labels_in, labels_out : str or None
        Names in the store of the labels of the pass before and of this one.
    elected_in, elected_labels_in, elected_out : str or None
        Of the points elected before, of their labels, and of those that this pass elects.
    of_elected : bool
        The labels of this pass are those of elected points.
    of_candidates, in_of_candidates : bool
        Whether the labels of this pass, and those of the pass before, are those of candidates alone, as no later pass
        reads others.
    held_bytes : int
        Of buckets kept for their neighbours.
    """

    method: str
    parameters: Mapping[str, Any]
    number: int
    state: Mapping[str, Any]
    cells: tuple[Cell, ...]
    halo: int
    max_halo: int
    keep_classes: tuple[int, ...]
    skip_flags: int
    labels_in: str | None
    labels_out: str
    elected_in: str | None
    elected_labels_in: str | None
    elected_out: str | None
    of_elected: bool
    of_candidates: bool
    in_of_candidates: bool
    held_bytes: int = field(metadata=NOT_IN_DIGEST)

    def place(self, buckets: Lattice) -> Bounds | None:
        """Bounds of the core."""
        return buckets.hull(self.cells)
