"""Tile that a task filters in one pass."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from tiler.core.lattice import Cell
from tiler.core.records import NOT_IN_DIGEST


@dataclass(frozen=True)
class FilterTile:
    """Tile of a pass.

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
        Points with one of these classes or flags keep their class and take no part in filtering, see
        `tiler.core.points.participates`.
    labels_in : str or None
        Name in the store of the labels that this pass reads; None if it reads none.
    labels_out : str
        Name in the store of the labels that this pass writes.
    elected_in : str or None
        Name in the store of the elected points that this pass reads (see `ptd.passes.Pass.elected`).
    elected_labels_in : str or None
        Name in the store of the labels of these elected points.
    elected_out : str or None
        Name in the store of the points that this pass elects.
    labels_elected : bool
        Whether this pass labels the elected points that it reads, instead of points of the cloud.
    candidates_only : bool
        Whether this pass labels only candidates, because later passes do not read other labels.
    input_candidates_only : bool
        Whether ``labels_in`` has labels only of candidates.
    held_bytes : int
        Limit of the bytes of buckets that are kept in memory because they are also read as margins of other buckets.
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
    labels_elected: bool
    candidates_only: bool
    input_candidates_only: bool
    held_bytes: int = field(metadata=NOT_IN_DIGEST)
