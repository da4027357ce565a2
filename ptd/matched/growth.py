"""Growth of the ground up to the edges of terraces and banks, below which a hull of limited curvature passes.

A hull reaches the top of a step some metres behind its edge. So ground grows there cell by
cell. A cell above the surface joins in one of three cases:

- It lies on the plane through the ground cells next to it. Objects on the ground rise from it
  at a wall, so they do not lie on the plane of the cells next to them.
- It is level with the ground cells that touch it. At the top of a bank the plane of the bank
  passes above the level cells behind its edge, and there are too few level cells to define
  another plane.
- It is terrain as a whole (`ptd.matched.objects`) and lies between ground cells on opposite
  sides and below the upper one. The faces of banks do not lie on a plane either.

The hull passes up to 12 m below the edges of high steps, as in quarries. Roofs and decks of
bridges are as high, but there the surroundings are lower on both sides. Such *strips* join only
near the ground and near the surface.
"""

from __future__ import annotations

import numpy as np

from ptd.arrays import Bool, Float64, Int64
from ptd.kernel import kernel
from ptd.matched.cells import CELL_M

GROWS_M, STRIP_GROWS_M = 16.0, 8.0
"""Largest distance to which ground grows, and to which it grows onto strips."""
MAX_HEIGHT_M, STRIP_MAX_HEIGHT_M = 12.0, 3.0
"""Largest height above the surface of a cell that joins, and of a strip: roofs of houses on
slopes may continue the terrain above."""
STRIP_M, STRIP_FALL_M = 16.0, 2.0
"""A cell belongs to a strip if within the first distance, on both sides along one of four
directions, a cell is lower by more than the second."""
PLANE_CELLS = 2
"""Largest distance of the ground cells of a plane, in cells along rows and along columns."""
PLANE_SQUARE = 5
"""Square of the largest distance of the ground cells of a plane, in cells."""
LEAST = 6
"""Least number of ground cells that define a plane."""
BESIDE = 2
"""Minimum number of adjacent ground cells for a cell to join in the first two cases."""
BETWEEN_CELLS, BETWEEN_SHARE = 3, 0.7
"""Largest distance in cells of ground cells on opposite sides, and the share of the way from
the lower to the upper one up to which a cell between them joins."""
LEVEL = 3.0
"""Weight of a slope of 0 in the fit of a plane, in cells squared: a few cells in a row do not
determine the slope across it."""
NEAR_M, NEAR_SIGMAS = 0.12, 1.5
"""Maximum distance of a cell from the plane: metres, plus this multiple of the local noise. It
is multiplied by the narrowing, so it is smaller among plants."""

LEVEL_SHARE = 0.7
"""Fraction of that distance within which a cell is level with those that touch it. It is less
than 1, because among plants a level neighbour is found nearly everywhere."""


def reach_cells(cell_m: float) -> int:
    """Return the distance in cells beyond which heights do not change whether a cell joins."""
    steps = round(GROWS_M / cell_m)
    return steps * max(PLANE_CELLS, BETWEEN_CELLS) + round(STRIP_M / cell_m)


@kernel
def _falls(
    height: Float64, there: Bool, row: int, column: int, way: tuple[int, int], reach: int
) -> bool:
    """Return whether a cell in a direction is lower by more than `STRIP_FALL_M`."""
    for k in range(1, reach + 1):
        r, c = row + k * way[0], column + k * way[1]
        if not (0 <= r < height.shape[0] and 0 <= c < height.shape[1]):
            return False
        if there[r, c] and height[r, c] < height[row, column] - STRIP_FALL_M:
            return True
    return False


@kernel
def _are_strips(height: Float64, there: Bool, rows: Int64, columns: Int64, reach: int) -> Bool:
    """Return a mask of the given cells that belong to strips."""
    strips = np.zeros(rows.size, np.bool_)
    for k in range(rows.size):
        for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
            strips[k] |= _falls(height, there, rows[k], columns[k], (dr, dc), reach) and _falls(
                height, there, rows[k], columns[k], (-dr, -dc), reach
            )
    return strips


@kernel
def _above_level(height: Float64, ground: Bool, row: int, column: int) -> float:
    """Return how far a cell lies above the mean of the adjacent ground cells, or NaN if there are too few."""
    n, total = 0, 0.0
    for r in range(row - 1, row + 2):
        for c in range(column - 1, column + 2):
            if ground[r, c]:
                n += 1
                total += height[row, column] - height[r, c]
    return total / n if n >= BESIDE else np.nan


@kernel
def _above_plane(height: Float64, ground: Bool, row: int, column: int) -> float:
    """Return how far a cell lies above the plane through the ground cells around it, or NaN if there are too few."""
    n, s, sx, sy, sz = 0, 0.0, 0.0, 0.0, 0.0
    sxx, sxy, syy, sxz, syz = 0.0, 0.0, 0.0, 0.0, 0.0
    for dy in range(-PLANE_CELLS, PLANE_CELLS + 1):
        for dx in range(-PLANE_CELLS, PLANE_CELLS + 1):
            square = dx * dx + dy * dy
            if square <= PLANE_SQUARE and ground[row + dy, column + dx]:
                w, z = (
                    1.0 / (1.0 + 0.3 * square),
                    height[row + dy, column + dx] - height[row, column],
                )
                n += 1
                s, sx, sy, sz = s + w, sx + w * dx, sy + w * dy, sz + w * z
                sxx, sxy, syy = sxx + w * dx * dx, sxy + w * dx * dy, syy + w * dy * dy
                sxz, syz = sxz + w * dx * z, syz + w * dy * z
    if n < LEAST:
        return np.nan
    x, y, z = sx / s, sy / s, sz / s
    xx, xy, yy = sxx - s * x * x + LEVEL, sxy - s * x * y, syy - s * y * y + LEVEL
    xz, yz = sxz - s * x * z, syz - s * y * z
    area = xx * yy - xy * xy
    east, north = (xz * yy - yz * xy) / area, (yz * xx - xz * xy) / area
    return east * x + north * y - z


@kernel
def _is_between(height: Float64, ground: Bool, row: int, column: int) -> bool:
    """Return whether a cell lies on a face between ground cells on opposite sides."""
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        ahead, behind = np.nan, np.nan
        for k in range(BETWEEN_CELLS, 0, -1):
            if ground[row + k * dr, column + k * dc]:
                ahead = height[row + k * dr, column + k * dc]
            if ground[row - k * dr, column - k * dc]:
                behind = height[row - k * dr, column - k * dc]
        middle, half = 0.5 * (ahead + behind), 0.5 * abs(ahead - behind)
        # The sum is NaN, and so the test fails, if there is ground on one side only.
        if height[row, column] < middle + (2 * BETWEEN_SHARE - 1) * half:
            return True
    return False


@kernel
def _grow(
    height: Float64,
    ground: Bool,
    terrain: Bool,
    near: Float64,
    rows: Int64,
    columns: Int64,
    steps: Int64,
) -> Float64:
    """Return the heights of cells that joined the ground, NaN elsewhere, and add these cells to ``ground``.

    All cells that join in a step do so together. A cell joins in the first ``steps`` of its
    steps.
    """
    joined_heights = np.full(height.shape, np.nan)
    waiting = np.ones(rows.size, np.bool_)
    joins = np.empty(rows.size, np.int64)
    for step in range(steps.max() if rows.size else 0):
        n = 0
        for k in range(rows.size):
            r, c = rows[k], columns[k]
            if not waiting[k] or step >= steps[k]:
                continue
            level = _above_level(height, ground, r, c)
            above = 0.0
            if not (terrain[r, c] and _is_between(height, ground, r, c)):
                above = np.nan if np.isnan(level) else _above_plane(height, ground, r, c)
                if not abs(above) < near[r, c] and abs(level) < LEVEL_SHARE * near[r, c]:
                    above = level
            if abs(above) < near[r, c]:
                joined_heights[r, c] = height[r, c] - 0.5 * above
                joins[n] = k
                n += 1
        if n == 0:
            break
        for k in joins[:n]:
            ground[rows[k], columns[k]], waiting[k] = True, False
    return joined_heights


def grown(
    height: Float64,
    there: Bool,
    ground: Bool,
    above: Float64,
    terrain: Bool,
    sigma: Float64,
    narrowing: Float64,
    cell_m: float = CELL_M,
) -> Float64:
    """Return the heights of cells that join the ground: float64 [rows, columns].

    The height is halfway between the cell and the plane, or between the cell and the mean of
    the level cells that touch it. Cells on a face keep their height. It is NaN where no cell
    joins.

    Parameters
    ----------
    height : float64 [rows, columns]
        Heights of cells in metres.
    there : bool [rows, columns]
        Cells that have a height; none lie within `BETWEEN_CELLS` of the raster's edges.
    ground : bool [rows, columns]
        Cells that are ground.
    above : float64 [rows, columns]
        Heights in metres above the surface of the cells that may join; NaN elsewhere.
    terrain : bool [rows, columns]
        Cells of surfaces that are terrain as a whole.
    sigma, narrowing : float64 [rows, columns]
        Noise in metres, and factor of the largest distance to the plane (`ptd.matched.surface.Surface`).
    cell_m : float
        Size of the cells in metres.
    """
    rows, columns = (np.ascontiguousarray(i) for i in np.nonzero(above < MAX_HEIGHT_M))
    strips = _are_strips(height, there, rows, columns, round(STRIP_M / cell_m))
    joins = ~strips | (above[rows, columns] < STRIP_MAX_HEIGHT_M)
    rows, columns, strips = rows[joins], columns[joins], strips[joins]
    steps = np.where(strips, round(STRIP_GROWS_M / cell_m), round(GROWS_M / cell_m))
    near = (NEAR_M + NEAR_SIGMAS * sigma) * narrowing
    return _grow(height, ground.copy(), terrain, near, rows, columns, steps)
