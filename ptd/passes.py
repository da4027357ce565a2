"""The interface of methods: a method runs over tiles as a sequence of passes.

A pass gets the candidates of a window (`Pass.fit`) and returns a model. The model labels points in pieces
(`Model.label`) and gives the window's part of run-wide statistics (`Model.partial`). `Pass.reduce` merges the
partials of all tiles, in any order, into the state that the next pass gets. A pass is the unit of scheduling and of
resume.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from ptd import places
from ptd.frame import Scale, Window

Int32 = npt.NDArray[np.int32]
UInt8 = npt.NDArray[np.uint8]
UInt16 = npt.NDArray[np.uint16]
State = Mapping[str, Any]
"""Figures of the run, JSON-able. At first ``{"run": RunHints as dict}``. ``notes`` is a list of lines on decisions from
the data, to which `Pass.reduce` may add. ``places`` holds the figures of each place (`ptd.places`). A task carries the
part that its window needs (`Pass.local`)."""

LOOKED_AT = {"run": ("sigma_m", "kind"), "survey": ("kind",), "canopy": ()}
"""Names that passes read in these entries of a state. Other names are only for display, and change with each added
file."""


KINDS = ("lidar", "dim")
"""Origins of a cloud: laser scanning, or image matching."""


def noted(state: State, *lines: str) -> list[str]:
    """The notes of a state and further notes."""
    return [*state.get("notes", []), *lines]


class MethodRefusal(ValueError):
    """Error with one line for the user: the statistics show that the method cannot work on this run."""


@dataclass(frozen=True)
class RunHints:
    """Facts about a run that are known before its first pass and seldom change with an added file.

    Attributes
    ----------
    sigma_m : float or None
        Noise of heights given by the user (``--sigma``).
    kind : {"lidar", "dim"} or None
        Origin of the cloud, laser scanning or image matching, as the user gives it (``--kind``) or the fields of its
        points show it. None: the positions of the points have to decide as well.
    sure : float or None
        Probability that the kind is right; None if the user gives it.
    why : str or None
        Evidence for the kind, in words.
    evidence : dict or None
        `ptd.Evidence` as plain values, if it does not decide alone.
    """

    sigma_m: float | None = None
    kind: str | None = None
    sure: float | None = None
    why: str | None = None
    evidence: dict[str, float | None] | None = None


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
        """x, y, z, each contiguous."""
        x, y, z = (np.ascontiguousarray(c) for c in self.xyz)
        return x, y, z

    def known_labels(self) -> UInt8:
        """Return the labels, which the pass must have named in its columns."""
        if self.labels is None:
            raise ValueError("the pass was given no labels")
        return self.labels

    def take(self, index: npt.NDArray[Any] | slice) -> Points:
        """The points of an index or mask, in its order."""

        def taken(column: Any) -> Any:
            if column is None:
                return None
            if isinstance(index, np.ndarray) and index.dtype.kind == "i":
                return np.take(column, index, axis=-1)  # several times as fast
            return np.ascontiguousarray(column[..., index])

        return Points(taken(self.xyz), taken(self.labels), taken(self.rgb), taken(self.returns))


def joined(parts: Sequence[Points]) -> Points:
    """Points of all parts (at least one), one after the other, with the columns that all parts have."""

    def column(name: str) -> Any:
        columns = [getattr(part, name) for part in parts]
        return None if any(c is None for c in columns) else np.concatenate(columns, axis=-1)

    return Points(*(column(f.name) for f in fields(Points)))


class Model(ABC):
    """The result of a pass in a window.

    Attributes
    ----------
    stats : dict
        Counts and rounds for the log, JSON-able.
    """

    stats: dict[str, Any]

    @abstractmethod
    def label(self, points: Points) -> tuple[UInt8, npt.NDArray[np.bool_]]:
        """Return labels (uint8 [n], below 128) and a mask of uncertified labels (bool [n]) of points of the window.

        Labels of the last pass are ASPRS classes; the method defines those of earlier passes. Not called if the pass
        gives no labels. With `Pass.label_margin_m` other points follow those to be labelled; their labels are
        ignored.
        """

    def elect(self, bounds: Window) -> Int32:
        """The elected points whose x and y lie within half-open bounds: int32 [3, m], local counts.

        Called for parts of the core, only if the pass elects. Points and their order must follow only from their
        surroundings, not from the window or the bounds. In a tiled run the bounds are those of a bucket, which
        keeps at most as many elected points as its rows hold points. Cells with one elected point each nest in
        buckets if 8 m are a whole number of cells.
        """
        raise NotImplementedError("the pass elects no points")

    def partial(self) -> dict[str, Any]:
        """The core's part of the run's statistics, JSON-able. Each point lies in one core."""
        return {}

    def uncertain(self) -> int:
        """Number of points of the core that `partial` may count wrongly, because points beyond the window are unknown.

        A core with such points is repeated with a wider halo, like one with uncertified labels.
        """
        return 0


class StatisticsModel(Model):
    """The result of a pass that gives no labels.

    Parameters
    ----------
    partial : dict
        The core's part of the statistics, see `Model.partial`.
    stats : dict, optional
    """

    def __init__(self, partial: dict[str, Any], stats: dict[str, Any] | None = None) -> None:
        self._partial, self.stats = partial, stats or {}

    def label(self, points: Points) -> tuple[UInt8, npt.NDArray[np.bool_]]:
        """Raise NotImplementedError, as the pass gives no labels."""
        raise NotImplementedError("the pass gives no labels")

    def partial(self) -> dict[str, Any]:
        """The measured part of the core."""
        return self._partial


class Pass(ABC):
    """One step of a method that needs only a window and the state.

    Attributes
    ----------
    name : str
        Unique in the method; its state is kept as ``after-<name>``.
    title : str
        A few words on what the pass does; if empty, the name is used.
    columns : tuple of str
        Columns of `Points` that the pass needs besides xyz: ``labels``, ``rgb``, ``returns``.
    every_point : bool
        Whether `fit` gets all points of the window instead of one candidate per cell of `candidate_cell_m`.
    gives_labels : bool
        Whether the pass labels points; otherwise it only measures. The last pass of a method gives labels.
    halo_m : float or None
        Width of the halo in metres that this pass seldom exceeds. None: that of the method.
    reach_m : float or None
        Distance beyond which nothing can change the result at a place. A window with exactly this margin around its
        core gives the untiled answer, without wider halos or open sides. 0: the core suffices. None: no such bound.
    elects : bool
        Whether the pass makes new points (`Model.elect`), for example one per cell, for later `elected` passes.
        If it gives labels, `Model.label` gets these points, with xyz only, and labels them. The next such pass replaces
        them.
    elected : bool
        Whether `fit` gets the elected points of the window instead of the cloud's: xyz and, if named, the labels of the
        last such pass (0 before that). `Model.label` labels elected points too, for the next such pass. If no later
        pass applies, `Model.label` gets all points of the cloud with their labels, and labels them.
    label_margin_m : float
        Margin of points that `Model.label` needs around those that it labels. It gets these first. Then come, in any
        order, all other points of the filter within this distance of their bounding box.
    kind : {"lidar", "dim"} or None
        Origin of the clouds to which the pass applies. None: all clouds.
    raster_cell_m : float
        Side of the cells of a raster of the whole window that the pass makes, and that determines its memory. 0: the
        pass makes no such raster, and the points determine its memory.
    by_place : bool
        Whether `fit` reads the figures of places in the state.
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
    by_place: bool = False

    def applies(self, state: State) -> bool:
        """Whether the pass is done, given the state after the passes before it.

        Some passes are needed only in some runs, as the survey decides. Later passes must not change the answer. Passes
        that give labels or elect depend on which later passes apply, so the deciding pass comes before them. Of the
        passes that apply, the last labels all points.
        """
        return True

    @abstractmethod
    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> Model:
        """Work on the points of a window, in any order. Only the core counts for `Model.partial`."""

    def local(self, state: State, window: Window, scale: Scale) -> dict[str, Any]:
        """Return the part of a state that `fit` needs for a window, so that distant files do not change it."""
        found = {name: value for name, value in state.items() if name not in ("notes", places.PLACES)}
        for name, looked_at in LOOKED_AT.items():
            if name in found:
                found[name] = {key: value for key, value in found[name].items() if key in looked_at}
        if self.by_place and places.PLACES in state:
            found[places.PLACES] = places.near(state[places.PLACES], window, scale)
        return found

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        """Return the state after the pass, which must not depend on the order of the partials.

        `MethodRefusal` ends the run.
        """
        return dict(state)


def later_passes(passes: Sequence[Pass], number: int, state: State) -> list[Pass]:
    """The passes after number `number` that apply, as far as the state before it shows."""
    return [step for step in passes[number + 1 :] if step.applies(state)]


def read_at_candidates(later: Sequence[Pass]) -> bool:
    """Whether there are later passes, and all of them read labels at candidates only.

    `Model.label` of such passes is given no labels, whatever it needs around the points.
    """
    return bool(later) and not any(step.every_point for step in later)


@dataclass(frozen=True)
class Method:
    """A filter with its name and its parameters.

    Attributes
    ----------
    name, summary : str
    params : type
        Frozen dataclass of `ptd.params.parameter` fields, the only home of the defaults. Its properties are ``passes``
        (tuple of `Pass`), ``halo_m`` (metres around a tile that decisions usually reach), ``align_m`` (side of the
        lattice cells to which windows are widened), ``margin_m`` (further widening) and ``candidate_cell_m`` (0: every
        point is a candidate).
    needs : tuple of str
        Columns that the method requires, such as ``rgb``.
    """

    name: str
    summary: str
    params: type[Any]
    needs: tuple[str, ...] = ()
