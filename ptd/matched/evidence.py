"""Evidence in the fields of a cloud's points on its source: laser scanning or dense image matching.

There are three pieces of evidence: traces of a sensor, intensities and colours. Each counts
once, and is skipped if a format has no such field. A weight is the natural logarithm of the
odds that the cloud is photogrammetric. Weights add up, and their sum gives the confidence of
the answer. All but `SEVERAL` were fitted to the fields of 114 real clouds of known origin
(`tests/benchmarks/kind_weights.py`). 111 of these clouds are decided correctly if their own
producer is left out of the fit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from ptd.arrays import AnyArray, Float64

LIDAR, DIM = "lidar", "dim"

SEVERAL, TRACE, NO_TRACE = -5.0, -2.3, 0.1
"""Weights of several returns, of other traces of a sensor, and of no trace. `SEVERAL` was not
fitted: of 126 clouds, 0 of 32 photogrammetric ones and 74 of 94 LiDAR ones have several
returns."""
OWN_INTENSITY, NO_INTENSITY, GREY_INTENSITY = -3.5, -0.2, 1.4
COLOUR, NO_COLOUR = 2.4, -1.5
"""Weights of colours and of missing colours. The fit gives -2.2 for missing colours. They weigh
less here, because only coloured photogrammetric clouds are published."""

SEVERAL_SHARE = 0.001
"""Several returns are evidence for LiDAR if at least this share of the points is one of
several."""
TRACED_SHARE = 0.2
"""A trace of a sensor has its full weight if at least this share of the area has it."""
SAME = 0.95
"""Intensities are the grey of the colours if they correlate at least this well; at most 0.71 in
LiDAR clouds."""
TIMES_PER_POINT = 0.01
"""Number of different GPS times per point above which a sensor measured them: each block of a
photogrammetric cloud has a single time."""
SURE = 0.9
"""Minimum confidence with which the fields of the points decide alone."""
MAX_CONFIDENCE = 0.99
"""Largest confidence that the weights allow."""


class Piece(NamedTuple):
    """A piece of evidence: its weight, which is above 0 if it indicates image matching, and its description."""

    weight: float
    text: str


class Finding(NamedTuple):
    """Source of a cloud: laser scanning or dense image matching.

    Attributes
    ----------
    kind : {"lidar", "dim"}
    sure : float or None
        Probability that the kind is right, 0.5 to `MAX_CONFIDENCE`; None if the user gives it.
    why : str
        Up to two strongest pieces of evidence for the kind, or who gave
        the kind.
    """

    kind: str
    sure: float | None
    why: str


@dataclass(frozen=True)
class Evidence:
    """Evidence in the fields of a cloud's points: shares from 0 to 1, or None if unknown.

    Attributes
    ----------
    several : float or None
        Share of the points that are one of several returns of a pulse.
    trace : float or None
        Share of the area in which GPS times, scan angles, scan directions, edges of flight lines or source ids differ
        from point to point.
    own_intensity, grey_intensity : float or None
        Shares of the area in which intensities vary: independent of the colours, or equal to their grey.
    colour : float or None
        Share of the area in which points are coloured.
    """

    several: float | None = None
    trace: float | None = None
    own_intensity: float | None = None
    grey_intensity: float | None = None
    colour: float | None = None

    @classmethod
    def of(
        cls,
        *,
        returns: npt.ArrayLike | None = None,
        gps_time: npt.ArrayLike | None = None,
        scan_angle: npt.ArrayLike | None = None,
        source_id: npt.ArrayLike | None = None,
        flags: Sequence[npt.ArrayLike] = (),
        intensity: npt.ArrayLike | None = None,
        rgb: npt.ArrayLike | None = None,
    ) -> Self:
        """Collect the evidence in the fields of all or some points of a cloud.

        Parameters
        ----------
        returns : array [n, 2], optional
            Return number and number of returns; 0 where unknown.
        gps_time, scan_angle, source_id, intensity : array [n], optional
        flags : sequence of array [n]
            Scan direction and edge of flight line.
        rgb : array [n, 3], optional
        """
        several = None
        if returns is not None:
            n_returns = np.asarray(returns)[:, 1]
            several = (
                float(np.mean(n_returns[n_returns > 0] > 1)) if np.any(n_returns) else None
            )
        differing = [
            None if v is None else _differs(np.asarray(v))
            for v in (scan_angle, source_id, *flags)
        ]
        differing.append(None if gps_time is None else _measured(np.asarray(gps_time)))
        known = [differs for differs in differing if differs is not None]
        colours = None if rgb is None else np.asarray(rgb, np.float64)
        measured, grey = _intensities(intensity, colours)
        return cls(
            several, float(any(known)) if known else None, measured, grey, _coloured(colours)
        )

    @classmethod
    def merged(cls, parts: Iterable[tuple[Self, float]]) -> Self:
        """Merge the evidence of several clouds of a survey, each weighted by its area or another weight."""
        weighted_parts = list(parts)
        means = []
        for field in fields(cls):
            known = [(getattr(part, field.name), area) for part, area in weighted_parts]
            known = [(value, area) for value, area in known if value is not None]
            total = sum(area for _, area in known)
            means.append(sum(value * area for value, area in known) / total if total else None)
        return cls(*means)

    def pieces(self) -> list[Piece]:
        """Return the known pieces of evidence."""
        pieces = [self._sensor(), self._intensity(), self._colour()]
        return [piece for piece in pieces if piece is not None]

    def _sensor(self) -> Piece | None:
        if self.several is not None and self.several >= SEVERAL_SHARE:
            # The share is that of a sample, which depends on how the cloud is cut into files.
            return Piece(SEVERAL, "some pulses have several returns")
        if self.several is None and self.trace is None:
            return None
        traced = min((self.trace or 0.0) / TRACED_SHARE, 1.0)
        weight = traced * TRACE + (1 - traced) * NO_TRACE
        if weight < 0:
            return Piece(
                weight, "GPS times, scan angles or flight lines differ from point to point"
            )
        return Piece(weight, "returns, GPS times, angles and flight lines show no sensor")

    def _intensity(self) -> Piece | None:
        if self.own_intensity is None or self.grey_intensity is None:
            return None
        none = 1 - self.own_intensity - self.grey_intensity
        weights = (
            OWN_INTENSITY * self.own_intensity,
            GREY_INTENSITY * self.grey_intensity,
            NO_INTENSITY * none,
        )
        texts = (
            "intensities were measured",
            "the intensities are the grey of the colours",
            "no intensities",
        )
        strongest = max(range(3), key=lambda i: abs(weights[i]))
        return Piece(sum(weights), texts[strongest])

    def _colour(self) -> Piece | None:
        if self.colour is None:
            return None
        weight = COLOUR * self.colour + NO_COLOUR * (1 - self.colour)
        return Piece(weight, "the points have colours" if weight > 0 else "no colours")


def concluded(pieces: Iterable[Piece]) -> Finding:
    """Decide the source of a cloud by the sum of all pieces of evidence.

    A cloud with even odds is photogrammetric.
    """
    all_pieces = list(pieces)
    score = sum(piece.weight for piece in all_pieces)
    side = 1.0 if score >= 0 else -1.0
    speaking = sorted(
        (p for p in all_pieces if side * p.weight > 0), key=lambda p: -abs(p.weight)
    )
    sure = min(1 / (1 + math.exp(-abs(score))), MAX_CONFIDENCE)
    return Finding(
        DIM if score >= 0 else LIDAR, sure, "; ".join(piece.text for piece in speaking[:2])
    )


def decided_by(evidence: Evidence) -> Finding | None:
    """Decide the source of a cloud, or return None if the fields of its points give less confidence than `SURE`.

    At least two pieces of evidence must be known.
    """
    pieces = evidence.pieces()
    finding = concluded(pieces)
    return finding if len(pieces) > 1 and (finding.sure or 0.0) >= SURE else None


def percent(share: float) -> str:
    """Format a share in percent with two significant digits, without an exponent from 0.0001 % on."""
    return f"{float(f'{100 * share:.2g}'):g}"


def _differs(values: AnyArray) -> bool:
    return bool(values.size and values.min() != values.max())


def _measured(times: AnyArray) -> bool:
    """Return whether a sensor measured the GPS times."""
    finite = times[np.isfinite(times)]
    return bool(np.unique(finite).size > max(TIMES_PER_POINT * times.size, 2))


def _coloured(colours: Float64 | None) -> float | None:
    """Return 1 if points have colours, 0 if they have none, and None if their colours are only grey values."""
    if colours is None or not colours.size:
        return None
    if colours.min() == colours.max():
        return 0.0
    return None if _is_grey(colours) else 1.0


def _is_grey(colours: Float64) -> bool:
    return bool(np.mean(np.ptp(colours, axis=1) == 0) > SAME)


def _intensities(
    intensity: npt.ArrayLike | None, colours: Float64 | None
) -> tuple[float | None, float | None]:
    """Return whether a sensor measured the intensities, and whether they are the grey of the colours.

    Each is 1 or 0, or None if unknown.
    """
    if intensity is None:
        return None, None
    values = np.asarray(intensity, np.float64)
    if not _differs(values):
        return 0.0, 0.0
    if colours is None or not _differs(grey := colours.mean(axis=1)):
        return 1.0, 0.0
    if np.corrcoef(values, grey)[0, 1] < SAME:
        return 1.0, 0.0
    # Grey colours may be painted with the intensity of a laser, so neither is evidence.
    return (None, None) if _is_grey(colours) else (0.0, 1.0)
