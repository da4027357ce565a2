"""Interface of methods: a method runs over tiles as a sequence of passes.

`Pass.fit` is passed the candidates of a window and returns a model. The model labels points in batches (`Model.label`)
and returns the part of the run-wide statistics that its core contributes (`Model.partial`). `Pass.reduce` merges these
parts of all tiles, in any order, into the state for the next pass. A pass is the unit of scheduling and of resume.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ptd import places
from ptd.arrays import AnyArray, Bool, Int32, UInt8, UInt16
from ptd.frame import Scale, Window

State = Mapping[str, Any]
"""Results of the passes for the whole run, by name, as values that JSON can hold.

The first state has only ``run``, which is a `RunHints` as a dict. ``notes`` is a list of lines
on decisions from the data; `Pass.reduce` may add lines. ``places`` is the table of the figures
of each place (`ptd.places`). The arguments of a task have only the part of the state that the
window of the task needs (`Pass.local`).
"""

Partial = Mapping[str, Any]
"""What the core of one window adds to the statistics of the run, as values that JSON can
hold."""
Stats = dict[str, Any]
"""Counts and rounds for the log, as values that JSON can hold."""

READ_NAMES = {"run": ("sigma_m", "kind", "checks_kind"), "survey": ("kind",), "canopy": ()}
"""Names of the values that passes read from these entries of a state.

`Pass.local` leaves out the other values of these entries: they are only for display, and change with each added file.
"""

KINDS = ("lidar", "dim")
"""Origins of a cloud: laser scanning, or image matching."""


def add_notes(state: State, *lines: str) -> list[str]:
    """Return the notes of a state, followed by further notes."""
    return [*state.get("notes", []), *lines]


class MethodRefusal(ValueError):
    """Error in one line for the user, raised if the statistics show that the method cannot work on this run."""


@dataclass(frozen=True)
class RunHints:
    """Facts about a run that are known before its first pass and seldom change with an added file.

    Attributes
    ----------
    sigma_m : float or None
        Noise of heights given by the user (``--sigma``).
    kind : {"lidar", "dim"} or None
        Origin of the cloud, laser scanning or image matching, as given by the user (``--kind``) or decided from the
        fields of the points. None if the positions of the points have to decide as well.
    sure : float or None
        Probability that the kind is right; None if the user gives the kind.
    why : str or None
        Evidence for the kind, in words.
    evidence : dict or None
        `ptd.Evidence` as plain values, if the evidence is not enough to decide the kind.
    checks_kind : bool
        Whether the positions of the points are measured to check the kind given by the user, because their fields do
        not decide it.
    """

    sigma_m: float | None = None
    kind: str | None = None
    sure: float | None = None
    why: str | None = None
    evidence: dict[str, float | None] | None = None
    checks_kind: bool = False


@dataclass(frozen=True)
class Points:
    """Columns of ``n`` points. Columns that a pass does not name in `Pass.columns` are None.

    Attributes
    ----------
    xyz : int32 [3, n]
        Local counts.
    labels : uint8 [n]
        Labels of the last pass that gave labels; 0 before that.
    rgb : uint16 [3, n]
        Colours of the sources; all 0 for a source without colours.
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
        """Return x, y and z as contiguous arrays."""
        x, y, z = (np.ascontiguousarray(c) for c in self.xyz)
        return x, y, z

    def known_labels(self) -> UInt8:
        """Return the labels. Raise ValueError if the pass does not name ``labels`` in its columns."""
        if self.labels is None:
            raise ValueError("the pass was given no labels")
        return self.labels

    def take(self, index: AnyArray | slice) -> Points:
        """Return the points that an index, a mask or a slice selects, in the order of the index."""

        def taken(column: Any) -> Any:
            if column is None:
                return None
            if isinstance(index, slice):
                return np.ascontiguousarray(column[..., index])
            # Both functions are several times faster than indexing.
            if index.dtype == np.bool_:
                return np.compress(index, column, axis=-1)
            return np.take(column, index, axis=-1)

        return Points(taken(self.xyz), taken(self.labels), taken(self.rgb), taken(self.returns))


def joined(parts: Sequence[Points]) -> Points:
    """Concatenate at least one part. Columns that a part lacks are left out."""

    def column(name: str) -> Any:
        columns = [getattr(part, name) for part in parts]
        return None if any(c is None for c in columns) else np.concatenate(columns, axis=-1)

    return Points(*(column(f.name) for f in fields(Points)))


class Model(ABC):
    """Result of a pass in a window.

    Attributes
    ----------
    stats : dict
        Counts and rounds for the log, JSON-able.
    """

    stats: Stats

    @abstractmethod
    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Return labels (uint8 [n], below 128) of points of the window, and a mask of uncertified labels (bool [n]).

        Labels of the last pass are ASPRS classes. The method defines the labels of earlier
        passes. If the pass gives no labels, `label` is not called. With `Pass.label_margin_m`,
        other points follow the points to label, and the labels of these other points are
        ignored.
        """

    def elect(self, bounds: Window) -> Int32:
        """Return the points that the pass elects within half-open bounds: int32 [3, m], local counts.

        `elect` is called only if `Pass.elects` is true, for parts of the core. The elected points and their order must
        depend only on the points of the cloud near them, not on the window or the bounds.

        In a tiled run, the bounds are those of a bucket. A bucket can store at most as many
        elected points as it has points. One elected point per cell always fits if no cell lies
        in two buckets, that is, if 8 m is a multiple of the size of a cell.
        """
        raise NotImplementedError("the pass elects no points")

    def partial(self) -> Partial:
        """Return what the core adds to the statistics of the run, as JSON-able values. Each point lies in one core."""
        return {}

    def uncertain(self) -> int:
        """Return how many core points `partial` may count wrongly, because points beyond the window are unknown.

        A core with such points is repeated with a wider halo, like one with uncertified labels.
        """
        return 0


class StatisticsModel(Model):
    """Result of a pass that gives no labels.

    Parameters
    ----------
    partial : mapping
        See `Model.partial`.
    stats : dict, optional
    """

    def __init__(self, partial: Partial, stats: Stats | None = None) -> None:
        self._partial, self.stats = partial, stats or {}

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Raise NotImplementedError, as the pass gives no labels."""
        raise NotImplementedError("the pass gives no labels")

    def partial(self) -> Partial:
        """Return what the core adds to the statistics of the run."""
        return self._partial


class Pass(ABC):
    """Step of a method that needs only a window and the state.

    Attributes
    ----------
    name : str
        Name that is unique in the method. The state after the pass is stored as ``after-<name>``.
    title : str
        Short description of the pass; if empty, the name is used.
    columns : tuple of str
        Columns of `Points` that the pass needs besides xyz: ``labels``, ``rgb``, ``returns``.
    every_point : bool
        Whether `fit` is passed all points of the window instead of one candidate per cell of `candidate_cell_m`.
    gives_labels : bool
        Whether the pass labels points. Other passes only compute statistics. The last pass of a method gives labels.
    halo_m : float or None
        Width of the halo in metres that usually suffices. None: the width that the method gives.
    influence_radius_m : float or None
        Points farther than this from a position, in metres, cannot change the result at the position. So a core with a
        halo of this width gives the same result as the whole cloud. 0: the core suffices. None: there is no such
        distance. Then halos may become wider, and windows may have open sides.
    elects : bool
        Whether the pass elects points: `Model.elect` makes new points, for example one per cell. Later passes with
        `elected` read these points, until another pass elects points. If the electing pass also gives labels,
        `Model.label` labels the elected points and is passed only their xyz.
    elected : bool
        Whether the pass reads elected points: `fit` is passed the elected points of the window instead of points of the
        cloud. Their column ``labels`` is that of the last pass that labelled elected points, or 0. `Model.label` labels
        elected points as well, unless no later pass applies. In that case it labels all points of the cloud, and is
        passed the labels of these points.
    label_margin_m : float
        Width in metres of the margin of points that `Model.label` needs. The points to label come first. They are
        followed, in any order, by all other points of the filter within this distance of their bounding box.
    kind : {"lidar", "dim"} or None
        Origin of the clouds to which the pass applies. None: all clouds.
    raster_cell_m : float
        Size of the cells of a raster of the whole window, if the pass makes one that determines its memory. 0: the
        number of points determines its memory.
    by_place : bool
        Whether `fit` reads the table of places in the state.
    """

    name: str
    title: str = ""
    columns: tuple[str, ...] = ()
    every_point: bool = False
    gives_labels: bool = True
    halo_m: float | None = None
    influence_radius_m: float | None = None
    elects: bool = False
    elected: bool = False
    label_margin_m: float = 0.0
    kind: str | None = None
    raster_cell_m: float = 0.0
    by_place: bool = False

    def applies(self, state: State) -> bool:
        """Return whether the pass is run, given the state after the earlier passes.

        The result may depend on an earlier pass that only computes statistics, such as the
        survey. It must not depend on any pass that gives labels or elects points, because such
        a pass needs to know which later passes apply. The last pass that applies labels all
        points.
        """
        return True

    @abstractmethod
    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Model:
        """Make the model of a window from the points of the window, in any order.

        `Model.partial` counts only points of the core.
        """

    def local(self, state: State, window: Window, scale: Scale) -> State:
        """Return the part of a state that `fit` needs for a window. Distant files do not change this part."""
        part = {
            name: value
            for name, value in state.items()
            if name not in ("notes", *places.TABLES)
        }
        for name, keys in READ_NAMES.items():
            if name in part:
                part[name] = {key: value for key, value in part[name].items() if key in keys}
        for name in places.TABLES:
            if self.by_place and name in state:
                part[name] = places.near(state[name], window, scale)
        return part

    def reduce(self, partials: Iterable[Partial], state: State) -> State:
        """Return the state after the pass, which must not depend on the order of the partials.

        Raise MethodRefusal to end the run.
        """
        return dict(state)


def later_passes(passes: Sequence[Pass], number: int, state: State) -> list[Pass]:
    """Return the passes after the pass `number` that apply according to the state before it."""
    return [step for step in passes[number + 1 :] if step.applies(state)]


def read_at_candidates(later: Sequence[Pass]) -> bool:
    """Return whether there are later passes, and all of them read labels only at candidates.

    Then only candidates are labelled, so `Model.label` of the later passes cannot use earlier
    labels of other points.
    """
    return bool(later) and not any(step.every_point for step in later)


@dataclass(frozen=True)
class Method:
    """Filter with its name and its parameters.

    Attributes
    ----------
    name, summary : str
    params : type
        Frozen dataclass of `ptd.params.parameter` fields with defaults, and with these properties (lengths in metres):

        - ``passes``: tuple of `Pass`.
        - ``candidate_cell_m``: size of the cells with one candidate each, or 0 if every point
          is a candidate.

        If a pass has no `Pass.influence_radius_m`, these are needed as well:

        - ``halo_m``: width of the halo that usually suffices.
        - ``align_m``: size of the lattice cells to which windows are widened.
        - ``margin_m``: width by which windows are widened further.
    needs : tuple of str
        Columns that the method requires, such as ``rgb``.
    for_lidar : bool
        Whether the defaults are made for laser scanning, so that a run on photogrammetric clouds warns.
    """

    name: str
    summary: str
    params: type[Any]
    needs: tuple[str, ...] = ()
    for_lidar: bool = False

    def __post_init__(self) -> None:
        for spec in fields(self.params):
            if "minimum" not in spec.metadata:
                raise TypeError(
                    f"method {self.name}: {spec.name} is a plain field; use ptd.params.parameter"
                )
        needed = ["passes", "candidate_cell_m"]
        if hasattr(self.params, "passes") and any(
            step.influence_radius_m is None for step in self.params().passes
        ):
            needed += ["halo_m", "align_m", "margin_m"]
        for name in needed:
            if not hasattr(self.params, name):
                raise TypeError(
                    f"method {self.name}: its parameters have no {name}; add a property (ptd.passes.Method)"
                )
