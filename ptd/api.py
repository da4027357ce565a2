"""Classify a cloud that fits into memory, without tiles."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from fractions import Fraction
from html import escape
from typing import Any

import numpy as np
import numpy.typing as npt

from ptd.arrays import AnyArray, Float64, Int32, UInt8
from ptd.cells import lowest_per_cell
from ptd.frame import CellLattice, Scale, Window
from ptd.matched.evidence import Evidence
from ptd.matched.survey import run_facts
from ptd.methods import METHODS
from ptd.params import to_json
from ptd.passes import (
    KINDS,
    Model,
    Pass,
    Points,
    RunHints,
    State,
    Stats,
    later_passes,
    read_at_candidates,
)
from ptd.places import TABLES

COUNTS_PER_METRE = 1000
BLOCK_POINTS = 8192
"""This many points are rounded at once, so that intermediate arrays stay in the processor's
cache."""
MIN_SIGMA_M = 1e-6
MAX_SIGMA_M = 1e3
MAX_SHOWN = 12
"""A notebook shows at most this many values of a list. For longer lists, it shows the number of
values."""
MAX_EXTENT_M = 60_000.0
"""A cloud extends at most this far, because in-circle tests are exact for differences below
2**26 counts."""
MAX_DISTANCE_M = 9e12
"""x and y are at most this far from 0, because counts are exact in float64 below 2**53."""
MAX_HEIGHT_M = 2_000_000.0
"""Heights are at most this far above or below 0, because heights are int32 counts."""
MAX_CELLS = 1 << 27
"""A raster of the whole extent has at most this many cells. A cell takes about 35 bytes."""

CLASS_NAMES = {1: "unclassified", 2: "ground", 7: "low noise"}


@dataclass(frozen=True)
class Result:
    """Labels and decisions of a filter, which a notebook displays as tables.

    Attributes
    ----------
    classification : uint8 [n]
        ASPRS: 1 unclassified, 2 ground, 7 low noise.
    decisions : mapping
        Method, effective parameters, and the statistics of the cloud on which the labels depend.
    stats : mapping of str to dict
        Statistics of each pass by name: candidates, vertices, rounds, outliers.
    """

    classification: UInt8
    decisions: Mapping[str, Any]
    stats: Mapping[str, Stats] = field(repr=False)

    @property
    def counts(self) -> dict[int, int]:
        """Number of points by class."""
        codes, counts = np.unique(self.classification, return_counts=True)
        return dict(zip(codes.tolist(), counts.tolist(), strict=True))

    def _repr_html_(self) -> str:
        classes = []
        for code, points in self.counts.items():
            classes.append((f"{code} {CLASS_NAMES.get(code, '')}", f"{points:,}"))
        title = f"ptd.classify: {self.classification.size:,} points by the method {self.decisions['method']}"
        parameters = _flat(self.decisions["parameters"])
        decided = _flat(self.decisions["statistics"])
        return (
            f"<div><b>{escape(title)}</b>{_table(('class', 'points'), classes)}"
            f"{_table(('decided', 'value'), decided)}"
            f"<details><summary>parameters</summary>{_table(('parameter', 'value'), parameters)}</details></div>"
        )


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Return nested values as pairs of name and text, with the lengths of long lists and of tables of places."""
    pairs = []
    for name, value in values.items():
        if name in TABLES:
            pairs.append((name, f"{len(value):,} values"))
        elif isinstance(value, Mapping):
            pairs += _flat(value, f"{prefix}{name} / ")
        elif isinstance(value, list | tuple) and len(value) > MAX_SHOWN:
            pairs.append((f"{prefix}{name}", f"{len(value):,} values"))
        elif value is not None:
            items = list(value) if isinstance(value, list | tuple) else [value]
            pairs.append((f"{prefix}{name}", "; ".join(_text(item) for item in items)))
    return pairs


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value)


def _table(headings: tuple[str, str], rows: list[tuple[str, str]]) -> str:
    """Return the HTML of a table, or an empty text if there are no rows."""
    if not rows:
        return ""
    head = "".join(f"<th>{escape(heading)}</th>" for heading in headings)
    body = "".join(
        f"<tr><td>{escape(name)}</td><td>{escape(value)}</td></tr>" for name, value in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def classify(
    xyz: npt.ArrayLike,
    method: str = "auto",
    params: Any = None,
    *,
    rgb: npt.ArrayLike | None = None,
    returns: npt.ArrayLike | None = None,
    sigma: float | None = None,
    kind: str | None = None,
    evidence: Evidence | None = None,
) -> Result:
    """Classify a cloud that fits into memory.

    Coordinates are rounded to millimetres. Lattices are anchored at coordinate 0, as in a tiled
    run.

    Parameters
    ----------
    xyz : float64 [n, 3]
        East, north, height in metres.
    method : str
        A name in `ptd.methods.METHODS`.
    params : dataclass, optional
        Parameters of the method; the defaults of the method if left out.
    rgb : uint16 [n, 3], optional
        Red, green and blue, in any range of values.
    returns : uint8 [n, 2], optional
        Return number and number of returns.
    sigma : float, optional
        Noise of heights in metres; if left out, estimated by the methods that need it.
    kind : {"lidar", "dim"}, optional
        Origin of the cloud, a laser scanner or image matching; decided from the data if left out.
    evidence : Evidence, optional
        Evidence on the origin of the cloud from other fields of the points; made by `Evidence.of`. Without it, the
        positions of the points decide, and the returns if they are given.

    Raises
    ------
    TypeError
        If `xyz` is an object of laspy; pass its ``xyz``.
    ValueError
        If `xyz` is not an [n, 3] array, has values that are not finite, extends over more than 60 km (134 km2 for a
        photogrammetric cloud), or has x or y beyond 9e12 m or heights beyond 2000 km.
        If the method or the kind is unknown, or the parameters belong to another method.
        If `sigma` is not from 1e-6 to 1000 m.
        If `rgb` or `returns` has a wrong shape or values that its type cannot hold, or is missing although the method
        needs it.
        If the method cannot work on the cloud (`ptd.passes.MethodRefusal`).

    Examples
    --------
    A plane of 1 point/m2 that rises to the east, with a box on it:

    >>> import numpy as np, ptd
    >>> x, y = (v.ravel() for v in np.mgrid[0:30.0, 0:30.0])
    >>> box = (abs(x - 15) < 3) & (abs(y - 15) < 3)
    >>> result = ptd.classify(np.stack([x, y, 0.05 * x + 6 * box], axis=1), method="classic")
    >>> result.counts, int(box.sum())
    ({1: 25, 2: 875}, 25)
    >>> result.decisions["parameters"]["iteration_angle_deg"]
    25.0
    """
    # Objects of laspy have these attributes. The package itself is not imported.
    if hasattr(xyz, "header") or hasattr(xyz, "point_format"):
        raise TypeError(
            f"xyz is a {type(xyz).__name__}, must be an array (n, 3) in metres: pass las.xyz"
        )
    points = np.asarray(xyz, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"xyz has shape {points.shape}, must be (n, 3): x, y, z in metres")
    if method not in METHODS:
        raise ValueError(f"no method {method!r}; there are {', '.join(METHODS)}")
    params_type = METHODS[method].params
    if params is None:
        params = params_type()
    # The parameters of a method may be a subclass of those of another method, so `isinstance`
    # is not enough.
    if type(params) is not params_type:
        raise ValueError(
            f"params is {type(params).__name__}, method {method} takes {params_type.__name__}"
        )
    if sigma is not None and not MIN_SIGMA_M <= sigma <= MAX_SIGMA_M:
        raise ValueError(f"sigma {sigma}: must be {MIN_SIGMA_M:g} to {MAX_SIGMA_M:g} m")
    counts, scale = _counts(points)
    columns = {
        "rgb": _column("rgb", rgb, len(points), 3, np.uint16),
        "returns": _column("returns", returns, len(points), 2, np.uint8),
    }
    for name in METHODS[method].needs:
        if columns[name] is None:
            raise ValueError(f"method {method} needs {name}")
    if kind not in (None, *KINDS):
        raise ValueError(f"no kind {kind!r}; there are {', '.join(KINDS)}")
    facts = run_facts(sigma, kind, evidence)
    labels, state, stats = do_passes(params, counts, columns, scale, Window.everything(), facts)
    return Result(
        labels, {"method": method, "parameters": to_json(params), "statistics": state}, stats
    )


def do_passes(
    params: Any,
    counts: Int32,
    columns: Mapping[str, Any],
    scale: Scale,
    window: Window,
    facts: RunHints,
) -> tuple[UInt8, State, dict[str, Stats]]:
    """Run all passes that apply on one window, and return labels, state, and the statistics of each pass."""
    state: State = {"run": asdict(facts)}
    stats = {}
    cell = None
    if params.candidate_cell_m:
        cell = CellLattice.of(params.candidate_cell_m, scale)
    cloud = _Cloud(Points(counts, np.zeros(counts.shape[1], np.uint8), **columns), cell)
    for number, step in enumerate(params.passes):
        if not step.applies(state):
            continue
        # A raster of a later pass that is too large is reported before the work of this pass.
        for other in params.passes[number:]:
            if other.raster_cell_m and other.applies(state):
                _validate_raster_size(counts, other.raster_cell_m, scale)
        model = step.fit(
            _with_columns_of(step, cloud.points_for(step)), window, window, scale, state
        )
        if step.elects:
            cloud.elect(model.elect(window), model if step.gives_labels else None)
        elif step.gives_labels:
            cloud.label(step, model, later_passes(params.passes, number, state))
        stats[step.name] = model.stats
        state = step.reduce([model.partial()], state)
    return cloud.everything.known_labels(), state, stats


def _validate_raster_size(counts: Int32, cell_m: float, scale: Scale) -> None:
    """Raise ValueError if the cells of a cloud's extent do not fit into memory, usually because of distant points."""
    if counts.shape[1] == 0:
        return
    sides = [
        float((int(axis.max()) - int(axis.min())) * scale.metres_xy) for axis in counts[:2]
    ]
    if math.prod(side / cell_m + 1 for side in sides) > MAX_CELLS:
        raise ValueError(
            f"xyz extends over {sides[0]:.0f} x {sides[1]:.0f} m, too much for a raster of {cell_m:g} m cells, which "
            "the method needs for a photogrammetric cloud; leave distant points out, or use tiles (`tiler run`)"
        )


@dataclass
class _Cloud:
    """Points of a cloud, with their labels.

    Attributes
    ----------
    everything : Points
        All points.
    cell : CellLattice or None
        Cells with one candidate each; None if the method has no cells.
    candidates : Points or None
        Candidates; None before the first pass that needs candidates.
    index : int32 [n] or None
        Index of each candidate among all points.
    elected : Points or None
        Points that the last electing pass made.
    """

    everything: Points
    cell: CellLattice | None
    candidates: Points | None = None
    index: Any = None
    elected: Points | None = None

    def points_for(self, step: Pass) -> Points:
        """Return the points that `Pass.fit` is passed."""
        if step.elected:
            if self.elected is None:
                raise ValueError(
                    f"pass {step.name} works on elected points, but no earlier pass elected any"
                )
            return self.elected
        if step.every_point or self.cell is None:
            return self.everything
        if self.candidates is None:
            self.index = lowest_per_cell(*self.everything.columns(), self.cell)
            self.candidates = self.everything.take(self.index)
        return self.candidates

    def elect(self, xyz: Int32, model: Model | None) -> None:
        """Replace the elected points by new ones. If there is a model, it labels the new points."""
        labels = np.zeros(xyz.shape[1], np.uint8)
        if model is not None:
            labels, _ = model.label(Points(xyz))
        self.elected = Points(xyz, labels)

    def label(self, step: Pass, model: Model, later: list[Pass]) -> None:
        """Label points by the model of a pass. `later` lists the following passes that apply.

        If later passes read labels only at elected points or only at candidates, other points
        are not labelled.
        """

        def labelled(points: Points) -> Points:
            return replace(points, labels=model.label(_with_columns_of(step, points))[0])

        if step.elected and later:
            self.elected = labelled(self.points_for(step))
            return
        if self.candidates is not None and read_at_candidates(later):
            self.candidates = labelled(self.candidates)
            return
        self.everything = labelled(self.everything)
        if self.candidates is not None and later:
            labels = self.everything.known_labels()[self.index]
            self.candidates = replace(self.candidates, labels=labels)


def _with_columns_of(step: Pass, points: Points) -> Points:
    """Return points with only the columns that a pass names."""
    return Points(points.xyz, **{name: getattr(points, name) for name in step.columns})


def _column(name: str, values: npt.ArrayLike | None, n: int, width: int, dtype: type) -> Any:
    """Return a column [width, n] from values [n, width], or None without values."""
    if values is None:
        return None
    rows = np.asarray(values)
    if rows.shape != (n, width):
        raise ValueError(
            f"{name} has shape {rows.shape}, must be ({n}, {width}), a row for each point"
        )
    if rows.dtype.kind not in "biuf":
        raise ValueError(f"{name} must be whole numbers from 0 to {np.iinfo(dtype).max}")
    with np.errstate(invalid="ignore"):  # The comparison below refuses NaN.
        column: AnyArray = np.ascontiguousarray(rows.T, dtype)
    if not np.array_equal(column, rows.T):
        raise ValueError(f"{name} must be whole numbers from 0 to {np.iinfo(dtype).max}")
    return column


def _counts(points: Float64) -> tuple[Int32, Scale]:
    """Convert coordinates in metres to local counts of a millimetre. Return counts, int32 [3, n], and their scale."""
    if len(points) == 0:
        return np.zeros((3, 0), np.int32), Scale()
    low = np.full(3, np.inf)
    high = np.full(3, -np.inf)
    for metres in _blocks(points):
        low = np.minimum(low, metres.min(axis=1))
        high = np.maximum(high, metres.max(axis=1))
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise ValueError("xyz has values that are not finite; leave those points out")
    extent = (high[:2] - low[:2]).max()
    if extent > MAX_EXTENT_M:
        raise ValueError(
            f"xyz extends over {extent / 1000:.0f} km; above {MAX_EXTENT_M / 1000:.0f} km use tiles"
        )
    highest = max(-low[2], high[2])
    if highest > MAX_HEIGHT_M:
        raise ValueError(
            f"xyz has heights of {highest:g} m above or below 0; up to {MAX_HEIGHT_M / 1000:.0f} km are allowed"
        )
    farthest = max(-low[:2].min(), high[:2].max())
    if farthest > MAX_DISTANCE_M:
        raise ValueError(
            f"xyz has x or y of {farthest:g} m; up to {MAX_DISTANCE_M:g} m from 0 are exact, so subtract an offset"
        )
    origin = [round(float(v) * COUNTS_PER_METRE) for v in low[:2]]
    counts = np.empty((3, len(points)), np.int32)
    first = 0
    shift = np.array([[*origin, 0]], np.float64).T
    for block in _blocks(points):
        block *= COUNTS_PER_METRE
        np.rint(block, out=block)
        block -= shift  # The difference is exact, as both are whole numbers below 2^53.
        counts[:, first : first + block.shape[1]] = block
        first += block.shape[1]
    unit = Fraction(1, COUNTS_PER_METRE)
    return counts, Scale(unit, unit, (origin[0], origin[1]))


def _blocks(points: Float64) -> Iterator[Float64]:
    """Yield copies of successive points, float64 [3, m], small enough to stay in the processor's cache."""
    for first in range(0, len(points), BLOCK_POINTS):
        yield np.array(points[first : first + BLOCK_POINTS].T, order="C")
