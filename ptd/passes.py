"""How a method runs over tiles: a sequence of passes.

A pass looks at the candidates of a window (`Pass.fit`) and gives a model that labels points in pieces
(`Model.label`) and says what the window contributes to run-wide statistics (`Model.partial`); `Pass.reduce`
merges the partials of all tiles, in any order, into the state that the next pass sees. A pass is the unit of
scheduling and of resume.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from ptd.frame import Scale, Window

Int32 = npt.NDArray[np.int32]
UInt8 = npt.NDArray[np.uint8]
UInt16 = npt.NDArray[np.uint16]
State = Mapping[str, Any]
"""JSON-able run-wide figures, small: each task carries them. Before the first pass: ``{"run": RunFacts as dict}``.
``notes``, a list of lines that `Pass.reduce` may lengthen, tell the user what was decided from the data."""


KINDS = ("lidar", "dim")
"""What made a cloud: laser scanning, or matching of images."""


def noted(state: State, *lines: str) -> list[str]:
    """The notes of a state, and more of them."""
    return [*state.get("notes", []), *lines]


class MethodRefusal(ValueError):
    """The method cannot work on this run, as only its statistics show; one line for the user."""


@dataclass(frozen=True)
class RunFacts:
    """What is known of a run before its first pass; nothing that changes with each file that is added.

    Attributes
    ----------
    sigma_m : float or None
        The noise of heights as the user says it (``--sigma``).
    kind : {"lidar", "dim"} or None
        What made the cloud as the user says it (``--kind``): laser scanning, or matching of images. None: to be
        decided from the data.
    """

    sigma_m: float | None = None
    kind: str | None = None


@dataclass(frozen=True)
class Points:
    """Columns of ``n`` points; those that a pass does not name in `Pass.columns` are None.

    Attributes
    ----------
    xyz : int32 [3, n]
        Local counts.
    labels : uint8 [n]
        Of the last pass that gave labels; 0: none yet.
    rgb : uint16 [3, n]
        As the sources give them; all 0 where a source has none.
    returns : uint8 [2, n]
        Return number and number of returns; 0 where unknown.
    """

    xyz: Int32
    labels: UInt8 | None = None
    rgb: UInt16 | None = None
    returns: UInt8 | None = None

    def __len__(self) -> int:
        return int(self.xyz.shape[1])

    def columns(self) -> tuple[Int32, Int32, Int32]:
        """x, y, z, each contiguous."""
        x, y, z = (np.ascontiguousarray(c) for c in self.xyz)
        return x, y, z

    def known_labels(self) -> UInt8:
        """The labels, of a pass that asked for them."""
        if self.labels is None:
            raise ValueError("the pass was given no labels")
        return self.labels

    def take(self, index: npt.NDArray[Any] | slice) -> Points:
        """The points of an index or mask, in that order."""

        def taken(column: Any) -> Any:
            return None if column is None else np.ascontiguousarray(column[..., index])

        return Points(taken(self.xyz), taken(self.labels), taken(self.rgb), taken(self.returns))


def joined(parts: Sequence[Points]) -> Points:
    """Points (at least one part) one after the other, with the columns that all parts have."""

    def column(name: str) -> Any:
        columns = [getattr(part, name) for part in parts]
        return None if any(c is None for c in columns) else np.concatenate(columns, axis=-1)

    return Points(*(column(f.name) for f in fields(Points)))


class Model(ABC):
    """A window after a pass.

    Attributes
    ----------
    stats : dict
        What was done, for the log: counts and rounds, JSON-able.
    """

    stats: dict[str, Any]

    @abstractmethod
    def label(self, points: Points) -> tuple[UInt8, npt.NDArray[np.bool_]]:
        """Labels (uint8 [n], below 128) and marks (bool [n]: not certified) of points of the window.

        The labels of the last pass are ASPRS classes; those of the passes before may mean anything to their method.
        Not called if the pass gives no labels. With `Pass.label_margin_m` other points follow those to be labelled:
        what is said of them is not used.
        """

    def elect(self, bounds: Window) -> Int32:
        """The elected points whose x and y lie within half-open bounds: int32 [3, m], local counts.

        Called only if the pass elects, for parts of the core. Which points there are and in which order must follow
        from what lies around them alone, whatever the window and the bounds. In a tiled run the bounds are those of a
        bucket, which keeps at most as many elected points as its rows hold of points: cells with one each nest in
        buckets if 8 m are a whole number of them.
        """
        raise NotImplementedError("the pass elects no points")

    def partial(self) -> dict[str, Any]:
        """What the window's core adds to the run's statistics, JSON-able; each point is in one core."""
        return {}

    def uncertain(self) -> int:
        """How many points of the core `partial` may count wrongly for want of what lies beyond the window.

        Like a core that carries a mark, one with such points is done again with a wider halo.
        """
        return 0


class Measured(Model):
    """A window of a pass that gives no labels.

    Parameters
    ----------
    partial : dict
        Of the core, see `Model.partial`.
    stats : dict, optional
    """

    def __init__(self, partial: dict[str, Any], stats: dict[str, Any] | None = None) -> None:
        self._partial, self.stats = partial, stats or {}

    def label(self, points: Points) -> tuple[UInt8, npt.NDArray[np.bool_]]:
        """Not called."""
        raise NotImplementedError("the pass gives no labels")

    def partial(self) -> dict[str, Any]:
        """What was measured."""
        return self._partial


class Pass(ABC):
    """One step of a method that needs no more than a window and the state.

    Attributes
    ----------
    name : str
        Unique in the method; its state is kept as ``after-<name>``.
    title : str
        What it does, in a few words for people; empty: its name says it.
    columns : tuple of str
        Of `Points` besides xyz: ``labels``, ``rgb``, ``returns``.
    every_point : bool
        `fit` wants all points of the window, not one candidate per cell of the method's `candidate_cell_m`.
    gives_labels : bool
        Else the pass only measures. The last pass of a method gives labels.
    halo_m : float or None
        Points around a tile with which this pass seldom needs more; None: as the method says.
    reach_m : float or None
        Where nothing farther from a place than this can change anything there, so that a window with so much around
        its core, no more and no less, gives the untiled answer: neither wider halos nor open sides are needed. 0: the
        core alone. None: no such bound.
    elects : bool
        The pass makes points of its own (`Model.elect`), say one a cell, for the passes after it that are on `elected`
        ones. If it gives labels, they are of these points: `Model.label` is then given elected ones, xyz alone. Another
        such pass after it replaces them.
    elected : bool
        `fit` is given the elected points of the window instead of the cloud's: xyz and, if asked for, the labels of the
        last such pass before (0: none yet). Labels of the pass are of elected points, and kept for the next such pass;
        those of the last pass that applies are of all points, as ever. So `Model.label` is given points of that sort,
        and labels among their columns are of points of that sort.
    label_margin_m : float
        `Model.label` needs the points around those that it labels: it is given those, then all others that take part
        in filtering within this distance of the rectangle that the first ones fill, in any order.
    kind : {"lidar", "dim"} or None
        What made the clouds that the pass is for: to others it does not apply. None: for all clouds.
    raster_cell_m : float
        Side of the cells of a raster that the pass makes of its window, over voids as well: memory follows from it. 0:
        it makes none, memory follows from the points.
    """

    name: str
    title: str = ""
    columns: tuple[str, ...] = ()
    every_point: bool = False
    gives_labels: bool = True
    halo_m: float | None = None
    reach_m: float | None = None
    elects: bool = False
    elected: bool = False
    label_margin_m: float = 0.0
    kind: str | None = None
    raster_cell_m: float = 0.0

    def applies(self, state: State) -> bool:
        """Whether the pass is done at all, given the state after the passes before; else it is passed over.

        For passes of which a run needs only some, as the survey decides. What is decided must stay: asked again with
        the state after a later pass, the answer is the same. Passes that give labels or elect ask this of all after
        them, so whoever decides comes before these. The last pass that applies labels all points.
        """
        return True

    @abstractmethod
    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> Model:
        """Work on the points (in any order) of a window, of which only the core counts for `Model.partial`."""

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        """The state after the pass; must not depend on the order of the partials. `MethodRefusal` ends the run."""
        return dict(state)


def later_passes(passes: Sequence[Pass], number: int, state: State) -> list[Pass]:
    """The passes after that of a number that apply, as far as the state before it tells."""
    return [step for step in passes[number + 1 :] if step.applies(state)]


def read_at_candidates(later: Sequence[Pass]) -> bool:
    """Whether the labels that come before some passes, at least one, are asked for at candidates alone."""
    return bool(later) and not any(step.every_point or step.label_margin_m for step in later)


@dataclass(frozen=True)
class Method:
    """A filter by name.

    Attributes
    ----------
    name, summary : str
    params : type
        Frozen dataclass of `ptd.params.parameter` fields, the only home of the defaults, with the properties ``passes``
        (tuple of `Pass`), ``halo_m`` (metres around a tile that decisions usually reach), ``align_m``
        (windows are widened to whole cells of this lattice), ``margin_m`` (and by this beyond) and
        ``candidate_cell_m`` (0: every point is a candidate).
    needs : tuple of str
        Columns without which the method refuses: ``rgb``.
    """

    name: str
    summary: str
    params: type[Any]
    needs: tuple[str, ...] = ()
