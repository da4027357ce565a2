"""``classic``: progressive TIN densification after Axelsson (2000), as TerraScan runs it.

Papers: 000 Dong 2018, 001 Chen 2023, 003 Ridge 2016. Parameters carry their unit in the name; ``--set`` takes the name
without it as well.

==================  =========================  =======  ==========================================================
parameter           paper's name and value     default  reason
==================  =========================  =======  ==========================================================
max_building_size   max building size: 30      20 m     003's value; larger cells lose hill tops, smaller ones
                    (000), 20 (003),                    take seeds on roofs. For halls and stadiums say more.
                    TerraScan 60
terrain_angle       terrain angle: 88          88 deg   the papers' value
iteration_angle     iteration angle: 6         25 deg   6 loses a quarter of the ground of the ISPRS samples (type
                                                        I 24 %); figures in ``docs/filters.md``
iteration_distance  iteration distance: 1.4    1.4 m    the papers' value for slopes
                    (slopes), 0.8 (flat)
edge_length_reduce  L1: 5, an illustration     5 m      keeps the wide angle from climbing onto low objects where
                                                        the TIN is dense
edge_length_stop    L2: 2, an illustration     0 (off)  its points would be lost to the TIN for nothing
rounds              none: until no point       8        later rounds are chains that climb roofs, and carry the
                    passes                              doubt of a tile's edge farther
thin_cell           m: about the DTM's         1 m      half the time and memory, 0.03 points of error
                    resolution (003)
low_radius, _depth, TerraScan's low points,    5 m, 4 m, a depth of 1.5 m deletes courtyards
low_group           no values                  5
label_pass          none                       on       ours: else points of facets that take no more vertices
                                                        are lost (type I)
label_floor         none                       0.3 m    ours: close to a vertex noise alone makes any angle
==================  =========================  =======  ==========================================================

Deviations: batch rounds instead of one point a facet at a time (001), so that order changes nothing; the mirrored
point keeps its height; a ring of virtual seeds around the data (001, step 5), never output; the last pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ptd.cells import Xyz, cell_keys, lowest_per_cell
from ptd.frame import Cells, Scale, Window
from ptd.ground.densify import densify_seeds
from ptd.ground.labelling import GroundRule, LowNoise, Terrain, unlabelled
from ptd.ground.outliers import low_outliers
from ptd.methods.progressive import Progressive
from ptd.params import parameter
from ptd.passes import Int32, Method, Model, Pass, Points, State, UInt8
from ptd.tin.mesh import Tin


@dataclass(frozen=True)
class Classic(Progressive):
    """Parameters of `classic`; see the module's table."""

    rounds: int = parameter(8, "rounds of densification; 0: until nothing passes", minimum=0, maximum=1000)
    label_pass: bool = parameter(
        True, "points near the finished TIN become ground too, not only its vertices"
    )

    @property
    def passes(self) -> tuple[Pass, ...]:
        """One pass: everything is local."""
        return (ClassicPass(self),)

    @property
    def halo_m(self) -> float:
        """Two seed cells for the first TIN's circles, 8 m for each round: measured to certify most tiles of a city."""
        return 2.0 * self.max_building_size_m + 8.0 * min(self.rounds or 30, 30)

    @property
    def candidate_cell_m(self) -> float:
        """Cell of which the lowest point is the candidate."""
        return self.thin_cell_m


@dataclass(frozen=True)
class ClassicPass(Pass):
    """The one pass of `classic`: outliers, seeds, densification."""

    params: Classic
    name: str = "classic"
    title = "seeds, densification, labels"

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> ClassicModel:
        """Densify the window's TIN."""
        return ClassicModel(self.params, points.xyz, window, scale)


class ClassicModel(Model):
    """A window's finished TIN."""

    def __init__(self, params: Classic, candidates: Int32, window: Window, scale: Scale) -> None:
        self.params, self.scale = params, scale
        p = params
        self.limits = p.limits(scale)
        self.cells = Cells.of(p.low_cell_m, scale)
        self._closed = window.closed
        x, y, z = thinned(candidates, p.thin_cell_m, scale)
        self.stats: dict[str, Any] = {
            "candidates": int(x.size),
            "rounds": 0,
            "low_outliers": 0,
            "vertices": 0,
        }
        self.terrain: Terrain | None = None
        if x.size:
            self._densify(x, y, z, window)

    def _densify(self, x: Int32, y: Int32, z: Int32, window: Window) -> None:
        p, scale = self.params, self.scale
        outlier = low_outliers(x, y, z, scale, p.low_radius_m, p.low_depth_m, p.low_group)
        # In a cell cut by the window another point may be the lowest; and outliers are certain a radius inside it.
        known = window.inside(self.cells, p.margin_cells)
        seed_cells = Cells.of(p.max_building_size_m, scale)
        tin, in_doubt, rounds = densify_seeds(
            Xyz(x, y, z), outlier, seed_cells, self.limits, p.rounds, known, scale
        )
        low = LowNoise(x[outlier], y[outlier], z[outlier], self.cells)
        self.terrain = self._terrain(tin, in_doubt, low)
        self.stats.update(rounds=rounds, low_outliers=int(outlier.sum()), vertices=tin.n_vertices)

    def _terrain(self, tin: Tin, in_doubt: UInt8, low: LowNoise) -> Terrain:
        """How the finished TIN labels."""
        p = self.params
        floor = self.scale.counts(p.label_floor_m) if p.label_pass else 0.0
        return Terrain(tin, in_doubt, low, GroundRule(self.limits, floor, vertices_only=not p.label_pass))

    def label(self, points: Points) -> tuple[UInt8, npt.NDArray[np.bool_]]:
        """Labels and marks of points of the window."""
        if self.terrain is None:
            return unlabelled(points, self._closed)
        return self.terrain.label(points)


def thinned(candidates: Int32, cell_m: float, scale: Scale) -> tuple[Int32, Int32, Int32]:
    """The lowest candidate per cell, in row-major order of the cells; all, in such an order, if `cell_m` is 0."""
    x, y, z = (np.ascontiguousarray(c) for c in candidates)
    if x.size == 0:
        return x, y, z
    if cell_m:
        keep: npt.NDArray[Any] = lowest_per_cell(x, y, z, Cells.of(cell_m, scale))
    else:
        c = Cells.of(1.0, scale)
        col0, row0 = c.column(int(x.min())), c.row(int(y.min()))
        keys = cell_keys(x, y, c.p, c.q, c.origin_x, c.origin_y, col0, row0, 1 << 31)
        keep = np.lexsort((z, y, x, keys))
    return x[keep], y[keep], z[keep]


METHOD = Method(
    "classic", "progressive TIN densification (Axelsson 2000), the reference for airborne LiDAR", Classic
)
