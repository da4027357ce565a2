"""Counts the ground points inside a correction before and after it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.core.classes import GROUND
from tiler.core.edits import TO_GROUND, Classes, Edit, Edits, can_be_ground, ground_with
from tiler.core.lattice import Cell, Lattice
from tiler.core.points import PointBlock
from tiler.grid.ground import GroundRule, read_classes
from tiler.store import open_store


@dataclass(frozen=True)
class SurveyEdit:
    """A correction whose points are counted: ``cell`` as of `tiler.core.edits.Edits`, ``cells`` that it touches."""

    rule: GroundRule
    edit: Edit
    cell: Lattice
    cells: tuple[Cell, ...]


def survey_edit(store_url: str, work: SurveyEdit) -> dict[str, Any]:
    """Count the points of one correction, as if there were no other; a `tiler.schedule.task.Work`.

    Returns
    -------
    dict
        ``points`` inside; ``ground_before``, ``ground_after`` of them; ``lowest``: whether the lowest points become
        ground, because the input classifies none as ground (or its own classes are being corrected).
    """
    store, rule, edit = open_store(store_url), work.rule, work.edit
    origin = store.meta.frame.origin

    def buckets() -> Iterator[tuple[PointBlock, Classes, npt.NDArray[np.bool_]]]:
        return (read_classes(store, rule, cell, needs_input=True) for cell in work.cells)

    lowest = edit.action == TO_GROUND and (
        rule.labels is None
        or not any(_given(edit, block, classes, origin) for block, classes, _ in buckets())
    )
    counts = np.zeros(3, np.int64)
    edits = Edits((replace(edit, lowest=lowest),), work.cell)
    for block, classes, is_ground in buckets():
        x, y = (block.xyz[axis].astype(np.int64) + origin[axis] for axis in (0, 1))
        inside, forced = edit.area.inside(x, y), edits.forced(block, classes, origin)
        after = ground_with(is_ground, forced)
        counts += [inside.sum(), (inside & is_ground).sum(), (inside & after).sum()]
    points, before, after_it = counts.tolist()
    return {"points": points, "ground_before": before, "ground_after": after_it, "lowest": lowest}


def _given(edit: Edit, block: PointBlock, classes: Classes, origin: tuple[int, int]) -> bool:
    """Whether the input classifies a point inside the correction as ground."""
    rows = np.flatnonzero((block.classification == GROUND) & can_be_ground(block, classes))
    x, y = (block.xyz[axis][rows].astype(np.int64) + origin[axis] for axis in (0, 1))
    return bool(edit.area.inside(x, y).any())
