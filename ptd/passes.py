"""How a method runs over tiles: a sequence of passes.

A pass looks at the candidates of a window (`Pass.fit`) and gives a model that labels points in pieces
(`Model.label`) and says what the window contributes to run-wide statistics (`Model.partial`); `Pass.reduce`
merges the partials of all tiles, in any order, into the state that the next pass sees. A pass is the unit of
scheduling and of resume.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ptd.frame import Scale, Window

Int32 = npt.NDArray[np.int32]
UInt8 = npt.NDArray[np.uint8]
State = Mapping[str, Any]
"""JSON-able run-wide figures."""


class Model(Protocol):
    """A window after a pass."""

    stats: dict[str, Any]
    """What was done, for the log: counts and rounds, JSON-able."""

    def label(self, xyz: Int32) -> tuple[UInt8, npt.NDArray[np.bool_]]:
        """Labels (uint8 [n], ASPRS) and marks (bool [n]: not certified) of points int32 [3, n] of the window."""
        ...

    def partial(self) -> dict[str, Any]:
        """What this window adds to the run's statistics, JSON-able; {} if the pass has none."""
        ...


class Pass(Protocol):
    """One step of a method that needs no more than a window and the state."""

    name: str

    def fit(self, candidates: Int32, window: Window, scale: Scale, state: State) -> Model:
        """Work on the candidates (int32 [3, n], any order) of a window."""
        ...

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        """The state after the pass; must not depend on the order of the partials."""
        ...


@dataclass(frozen=True)
class Method:
    """A filter by name.

    Attributes
    ----------
    name, summary : str
    params : type
        Frozen dataclass of `ptd.params.parameter` fields, the only home of the defaults, with the properties ``passes``
        (tuple of `Pass`), ``halo_m`` (points around a tile that decisions usually reach), ``align_m``
        (windows are widened to whole cells of this lattice), ``margin_m`` (and by this beyond) and
        ``candidate_cell_m`` (0: every point is a candidate).
    """

    name: str
    summary: str
    params: type[Any]
