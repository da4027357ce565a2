"""Cells of robust heights in a photogrammetric cloud, with the seeds that were found among its points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ptd.frame import CellLattice, Scale, Window
from ptd.ground.distance_angle import Bool, Int64
from ptd.ground.labelling import GROUND, UNCLASSIFIED
from ptd.matched.passes import CellModel, CellPass
from ptd.matched.step import cell_m
from ptd.passes import Int32, Points, State, UInt8


@dataclass(frozen=True)
class SeedCellPass(CellPass):
    """Pass that makes a robust height per cell. Cells with a seed are ground, all others unclassified."""

    title = "one height per cell, and the cells with seeds"
    columns: tuple[str, ...] = ("labels",)
    gives_labels: bool = True

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> SeedCells:
        """Find all cells, and those with seeds."""
        heights = super().fit(points, window, core, scale, state)
        seeds = points.known_labels() == GROUND
        return SeedCells(heights, points.xyz[:, seeds], CellLattice.of(cell_m(state), scale))


class SeedCells(CellModel):
    """Cells of robust heights, with a mask of those that contain a seed.

    Parameters
    ----------
    heights : CellModel
    seeds : int32 [3, m]
        Local counts.
    cells : CellLattice
    """

    def __init__(self, heights: CellModel, seeds: Int32, cells: CellLattice) -> None:
        super().__init__(heights.elect(Window.everything()))
        self._seeds, self._cells = seeds, cells

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Label the cells."""
        seeds = self._keys(self._seeds)
        holds = np.isin(self._keys(points.xyz), seeds)
        labels = np.where(holds, np.uint8(GROUND), np.uint8(UNCLASSIFIED))
        return labels, np.zeros(len(points), np.bool_)

    def _keys(self, xyz: Int32) -> Int64:
        columns, rows = self._cells.cell_indices(xyz[0], xyz[1])
        return columns * 2**32 + rows
