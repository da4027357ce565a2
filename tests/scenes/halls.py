"""Heights of a plain with a hall on it, in cells."""

from __future__ import annotations

import numpy as np

ROWS, COLUMNS = np.mgrid[:120, :150].astype(np.float64)


PLAIN = 0.02 * COLUMNS + 0.1 * np.sin(ROWS / 5)


def with_hall(
    high: float = 8.0,
    rows: slice = slice(40, 70),
    columns: slice = slice(50, 80),
    pitch: float = 0.0,
) -> np.ndarray:
    """A hall on a plain; its ridge along the rows' middle, `pitch` metres a cell above the eaves."""
    heights = PLAIN.copy()
    middle, half = (rows.start + rows.stop - 1) / 2, (rows.stop - rows.start) / 2
    heights[rows, columns] += high + pitch * (half - np.abs(ROWS - middle))[rows, columns]
    return heights
