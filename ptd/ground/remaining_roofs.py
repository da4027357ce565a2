"""Roofs that remain in a terrain model, found by the rule that removes roofs from a cloud (`ptd.ground.plateaus`).

Between a roof and the ground next to it the model is an interpolated ramp, which would join
both. So steep cells do not count as ground, because the cloud has no ground there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy

from ptd.frame import Scale
from ptd.ground.morphology import EMPTY, Bool, Float64
from ptd.ground.plateaus import ROOF_CELL_M, ROOF_STEPS_M, Plateaus, plateaus

MAX_WIDTH_M = 240.0
"""Width of the widest roof that is found."""
MILLIMETRES = Scale()


class RemainingRoof(NamedTuple):
    """A surface of the terrain that looks like a roof.

    Attributes
    ----------
    width_m : float
        Diameter of the largest circle inside, including the edge, in metres.
    row, column : float
        Centre of the surface's bounding box in cells.
    """

    width_m: float
    row: float
    column: float


def remaining_roofs(
    heights: Float64, cell_m: float = ROOF_CELL_M, min_width_m: float = 0.0
) -> list[RemainingRoof]:
    """Find the connected surfaces of a terrain model that lie above their surroundings.

    Each search depends on heights up to `reach_m` from a cell, and on the roofs found by the
    searches before.

    Parameters
    ----------
    heights : float64, shape (rows, columns)
        Heights in metres, NaN where unknown.
    cell_m : float
        Size of a cell in metres.
    min_width_m : float
        Width in metres below which surfaces are left out.
    """
    known = ~np.isnan(heights)
    if not known.any():
        return []
    counts, rises = np.full(heights.shape, EMPTY, np.int32), _rises(heights, known)
    counts[known] = np.rint(1000 * heights[known])
    is_roof = np.zeros(heights.shape, np.bool_)
    for step_m in ROOF_STEPS_M:
        roof_rule = Plateaus.of(MILLIMETRES, MAX_WIDTH_M, step_m, cell_m)
        ground = np.where(is_roof | (rises > step_m), EMPTY, counts).astype(np.int32)
        is_roof |= plateaus(ground, roof_rule, is_roof, known)
    numbers, _ = scipy.ndimage.label(is_roof, np.ones((3, 3)))
    boxes = scipy.ndimage.find_objects(numbers)
    roofs = (
        _measured(numbers[box] == number, box, cell_m)
        for number, box in enumerate(boxes, start=1)
    )
    return [roof for roof in roofs if roof.width_m >= min_width_m]


def _rises(heights: Float64, known: Bool) -> Float64:
    """Return the largest difference of each known height to those of its neighbours."""
    highest = scipy.ndimage.maximum_filter(np.where(known, heights, -np.inf), 3)
    lowest = scipy.ndimage.minimum_filter(np.where(known, heights, np.inf), 3)
    rises: Float64 = np.maximum(highest - heights, heights - lowest)
    return rises


def _measured(piece: Bool, box: tuple[slice, ...], cell_m: float) -> RemainingRoof:
    """Return the roof with the given cells. A row of cells at its edge was too steep to be found."""
    depth = scipy.ndimage.distance_transform_edt(np.pad(piece, 1))
    row, column = ((extent.start + extent.stop) / 2 for extent in box)
    return RemainingRoof(2 * (float(depth.max()) + 1) * cell_m, row, column)


def reach_m(cell_m: float = ROOF_CELL_M) -> float:
    """Return the distance in metres beyond which heights do not change the result of one search for roofs."""
    return (Plateaus.of(MILLIMETRES, MAX_WIDTH_M, cell_m=cell_m).reach + 1) * cell_m
