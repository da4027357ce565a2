"""Methods for LiDAR clouds, or for lowest points, adapted to photogrammetric clouds.

The papers' seeds and vertices are the lowest points of cells. In a photogrammetric cloud these
are blunders or the lower end of the noise. So a method gets one robust height per cell
(`ptd.matched.cells`) instead of the points. The cells that it classifies as ground are the
surface, and all points are compared with it to both sides, with the local noise and a vote of
their neighbours, as in `auto` (`ptd.matched.passes`). `for_both_kinds` builds passes that do so
if the survey finds a photogrammetric cloud, and that filter LiDAR clouds like the method's own
passes.

The surface is the TIN of these cells. Facets that are too wide are ignored, so vertices beyond a
fixed distance do not change a height.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from ptd.arrays import Bool, Float64, Int32
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.criteria import across
from ptd.ground.labelling import GROUND
from ptd.kernel import as_int64, kernel
from ptd.matched import ground_model, surface
from ptd.matched.cells import CELL_M, raster_of
from ptd.matched.evidence import DIM, LIDAR
from ptd.matched.ground_model import GROUND_M, GroundModel
from ptd.matched.passes import CellPass
from ptd.matched.step import OneSizePass, cell_m, is_matched, noise_m
from ptd.matched.survey import CELL_SIZES_M, SurveyPass
from ptd.params import parameter
from ptd.passes import Model, Partial, Pass, Points, State, add_notes
from ptd.tin.facets import Rule, facet_passes, plane_height
from ptd.tin.mesh import Tin
from ptd.tin.triangles import locate

MAX_CIRCUMRADIUS_M = 30.0
"""Largest circumradius of a facet that gives the height of the ground. Voids up to twice this
radius wide are spanned."""
ANY_EDGE = 2**62
"""Square of a length that no edge reaches."""


def facet_reach_m() -> float:
    """Return the distance in metres beyond which vertices do not change a height.

    A facet is the same as in an untiled run if no vertex of the whole cloud lies in its
    circumcircle (`docs/filters.md`, Certificates). No point of the circle is farther than two
    radii from a position in the facet.
    """
    return 2.0 * MAX_CIRCUMRADIUS_M + 1.0


def _ground_heights(x: Int32, y: Int32, z: Int32, ground: Bool, scale: Scale) -> Float64:
    """Return the height of the TIN of the ground cells at each cell, in vertical counts: float64 [n].

    It is NaN where the facet is too wide.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts of the cells.
    ground : bool [n]
        Mask of the ground cells, which are the vertices and keep their own heights.
    scale : Scale
    """
    tin = Tin.build(x[ground], y[ground], z[ground])
    heights = np.full(x.size, np.nan)
    if tin.n_triangles:
        rule = Rule(ANY_EDGE, scale.counts(MAX_CIRCUMRADIUS_M))
        _between_vertices(tin.vertex_array, tin.triangle_array, x, y, rule, heights)
    heights[ground] = z[ground]
    return heights


@kernel
def _between_vertices(
    vertices: Int32, triangles: Int32, x: Int32, y: Int32, rule: Rule, found: Float64
) -> None:
    """Interpolate the heights of cells into `found`.

    On an edge the heights on its two facets may differ by rounding. The higher one of facets
    that pass the rule counts.
    """
    t = as_int64(0)
    for i in range(x.size):
        px, py = as_int64(x[i]), as_int64(y[i])
        t = as_int64(locate(vertices, triangles, px, py, t))
        beside = across(vertices, triangles, t, px, py)
        for facet in (t, beside):
            if facet_passes(vertices, triangles, facet, rule):
                height = plane_height(vertices, triangles, facet, px, py, 1)
                if not found[i] >= height:
                    found[i] = height


@dataclass(frozen=True)
class RobustCells:
    """Parameter of methods that use `for_both_kinds`, which copy it with `ptd.params.like`."""

    robust_cells: bool = parameter(
        True, "photogrammetric clouds: start from one robust height per cell of 1 m (2 m if sparse), and judge points "
        "on both sides of the ground; no: start from the lowest points, as in the paper",
    )  # fmt: skip


def for_both_kinds(
    own: Sequence[Pass], on_cells: Sequence[Pass] | None = None, *notes: str
) -> tuple[Pass, ...]:
    """Return the passes of a method, on robust cell heights if the cloud is photogrammetric.

    Parameters
    ----------
    own : sequence of Pass
        Passes for LiDAR clouds.
    on_cells : sequence of Pass, optional
        Passes that label the cells of a photogrammetric cloud; `own` by default.
    *notes : str
        Further notes on a photogrammetric cloud.
    """
    cells = own if on_cells is None else on_cells
    return (
        MethodSurveyPass(notes=notes),
        *(OnLidar.of(step) for step in own),
        CellPass(),
        *(OnMatchedCells.of(step, f"{step.name}-of-cells") for step in cells),
        NearGroundPass(),
    )


@dataclass(frozen=True)
class MethodSurveyPass(SurveyPass):
    """Survey that decides the source of the cloud, unless the user gives laser scanning."""

    notes: tuple[str, ...] = ()

    def applies(self, state: State) -> bool:
        """Return whether the source has to be decided: not if the user gives laser scanning."""
        given_by_user = state["run"].get("sure") is None
        return not (given_by_user and state["run"].get("kind") == LIDAR)

    def reduce(self, partials: Iterable[Partial], state: State) -> State:
        """Add the survey to the state, with notes on its consequences for a photogrammetric cloud."""
        after = super().reduce(partials, state)
        if after["survey"]["kind"] != DIM:
            return after
        line = (
            f"decided: starts from one robust height per cell of {cell_m(after):g} m, not the lowest point. After a "
            f"vote of neighbours, ground is up to {GROUND_M:g} m plus twice the local noise from the surface "
            "(--set robust_cells=no: as in the paper)"
        )
        return {**after, "notes": add_notes(after, line, *self.notes)}


@dataclass(frozen=True)
class _Wrapped(Pass):
    """A pass with another condition under which it applies."""

    step: Pass
    name: str
    columns: tuple[str, ...]
    every_point: bool
    gives_labels: bool
    halo_m: float | None
    influence_radius_m: float | None

    @property
    def title(self) -> str:  # type: ignore[override]
        """Title of the wrapped pass."""
        return self.step.title

    @classmethod
    def of(cls, step: Pass, name: str | None = None) -> Self:
        """Wrap a pass, under another name if one is given."""
        copied = {
            f.name: getattr(step, f.name)
            for f in fields(cls)
            if f.name not in ("step", "name", "elected")
        }
        return cls(step=step, name=name or step.name, **copied)

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Model:
        """Fit the wrapped pass."""
        return self.step.fit(points, window, core, scale, state)

    def reduce(self, partials: Iterable[Partial], state: State) -> State:
        """Reduce the partials of the wrapped pass."""
        return self.step.reduce(partials, state)


@dataclass(frozen=True)
class OnLidar(_Wrapped):
    """A pass on points that applies to LiDAR clouds."""

    kind = LIDAR

    def applies(self, state: State) -> bool:
        """Return whether the wrapped pass applies and the survey did not find image matching."""
        return not ("survey" in state and is_matched(state)) and self.step.applies(state)


@dataclass(frozen=True)
class OnMatchedCells(_Wrapped):
    """A pass that labels the cells of a photogrammetric cloud."""

    kind = DIM
    elected: bool = True

    def applies(self, state: State) -> bool:
        """Return whether the wrapped pass applies and the survey found image matching."""
        return "survey" in state and is_matched(state) and self.step.applies(state)


@dataclass(frozen=True)
class NearGroundPass(OneSizePass):
    """Pass that classifies all points by their height above the TIN of the ground cells."""

    name: str = "near-ground"
    title = "label points near the ground"
    columns: tuple[str, ...] = ("labels",)
    elected: bool = True
    influence_radius_m: float | None = facet_reach_m() + max(
        (surface.noise_reach_cells(size_m) + 3) * size_m for size_m in CELL_SIZES_M
    )
    label_margin_m: float = ground_model.REACH_M
    raster_cell_m: float = CELL_M

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> GroundModel:
        """Compute the heights of the TIN at the cells, and the noise about it."""
        size_m = cell_m(state)
        cells, ground = CellLattice.of(size_m, scale), points.known_labels() == GROUND
        if not ground.any():
            return GroundModel(None, {"cells": 0})
        heights = _ground_heights(*points.columns(), ground, scale)
        raster = raster_of(points.xyz, cells)
        below = raster.spread(heights, np.nan)
        noise = raster.noise(noise_m(state, scale), cells)
        tin_surface = surface.with_noise(raster.heights, below, noise, scale, size_m)
        return GroundModel.of(tin_surface, raster, cells, scale, state)
