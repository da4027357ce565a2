"""Arguments of the task of a tile: the pass, the buckets that it labels, and names of inputs and outputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.schedule import NOT_IN_DIGEST


@dataclass(frozen=True)
class FilterTile:
    """Arguments of `tiler.filter.filter_tile`: one tile of a pass.

    Attributes
    ----------
    method : str
    parameters : mapping
        Parameters of the method, as JSON.
    number : int
        Number of the pass, from 0.
    state : mapping
        State after the earlier passes.
    cells : tuple of Cell
        Buckets of the core.
    halo, max_halo : int
        First and largest halo in counts.
    keep_classes, skip_flags : tuple of int, int
        Classes and flags of points that are excluded, see `tiler.core.classes.participates`.
    labels_in, labels_out : str or None
        Names in the store of the labels of the earlier pass and of this pass.
    elected_in, elected_labels_in, elected_out : str or None
        Names in the store of the points that an earlier pass elected, of their labels, and of the points that this pass
        elects.
    of_elected : bool
        Whether this pass labels elected points.
    of_candidates, in_of_candidates : bool
        Whether this pass, and the earlier pass, label only candidates, since later passes read only their labels.
    held_bytes : int
        Largest size of the buckets that are kept in memory for their neighbours, in bytes.
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
        """Return the bounds of the core."""
        return buckets.hull(self.cells)
