"""Spatial index of areas."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np

from tiler.core.area import Area
from tiler.core.lattice import Bounds, Cell, Lattice


class AreaIndex:
    """Index of areas by position. Its methods return ascending indices into ``areas``."""

    def __init__(self, areas: Sequence[Area]) -> None:
        import shapely

        self._areas = areas
        edges = np.array([area.bounds.to_json() for area in areas], np.float64).reshape(-1, 4)
        self._tree = shapely.STRtree(shapely.box(*edges.T))

    def overlapping(self, bounds: Bounds) -> list[int]:
        """Return the areas whose bounds overlap ``bounds``."""
        import shapely

        near = np.sort(self._tree.query(shapely.box(*bounds.to_json()))).tolist()
        return [i for i in near if self._areas[i].bounds.overlaps(bounds)]

    def touching(self, bounds: Bounds) -> list[int]:
        """Return the areas that touch ``bounds`` (see `Area.touches`)."""
        return [i for i in self.overlapping(bounds) if self._areas[i].touches(bounds)]

    def by_cell(self, lattice: Lattice, cells: Iterable[Cell]) -> dict[Cell, list[int]]:
        """Return the areas that touch each cell, without the cells that have no areas."""
        import shapely

        cell_bounds = [(cell, lattice.bounds(cell)) for cell in cells]
        edges = np.array([bounds.to_json() for _, bounds in cell_bounds], np.float64).reshape(
            -1, 4
        )
        pairs = self._tree.query(shapely.box(*edges.T))
        areas_by_cell: dict[Cell, list[int]] = defaultdict(list)
        for cell_number, i in pairs[:, np.lexsort(pairs[::-1])].T.tolist():
            cell, bounds = cell_bounds[cell_number]
            area = self._areas[i]
            if area.bounds.overlaps(bounds) and area.touches(bounds):
                areas_by_cell[cell].append(i)
        return dict(areas_by_cell)
