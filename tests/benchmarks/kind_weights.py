"""Fits the weights of `ptd.matched.evidence` to the fields of real clouds of known origin, one producer left out.

``python -m tests.benchmarks.kind_weights FINGERPRINTS.csv`` prints the weights and how many clouds come out right. A
producer's clouds are alike: each cloud weighs 1 / sqrt(clouds of its producer), and both kinds weigh the same in all.
"""

from __future__ import annotations

import csv
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from ptd.arrays import Float64
from ptd.matched.evidence import SAME, Evidence, concluded

RIDGE = 0.3
"""Weights are drawn to 0 by so much: there are few clouds of some sorts."""
SENSOR = ("share_several", "angle_distinct", "psid_distinct", "edge_used")
MAX_WITHOUT = (0, 1, 1, 0)
"""The highest values of these columns in a cloud without a trace of a sensor."""
NAMES = (
    "trace",
    "no trace",
    "own intensity",
    "no intensity",
    "grey intensity",
    "colour",
    "no colour",
)


@dataclass(frozen=True)
class Fingerprint:
    """The fields of one cloud.

    Attributes
    ----------
    producer : str
    matched : bool
        Whether it is from image matching.
    evidence : Evidence
    """

    producer: str
    matched: bool
    evidence: Evidence

    @property
    def terms(self) -> list[float]:
        """What each weight of `NAMES` is multiplied by."""
        e = self.evidence
        terms = [0.0] * len(NAMES)
        if e.trace is not None:
            terms[0:2] = [e.trace, 1 - e.trace]
        if e.own_intensity is not None and e.grey_intensity is not None:
            terms[2:5] = [
                e.own_intensity,
                1 - e.own_intensity - e.grey_intensity,
                e.grey_intensity,
            ]
        if e.colour is not None:
            terms[5:7] = [e.colour, 1 - e.colour]
        return terms


def read(path: Path) -> list[Fingerprint]:
    """The clouds of a table whose origin is known."""
    with path.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["truth"] in ("matched", "laser")]
    return [
        Fingerprint(row["producer"], row["truth"] == "matched", evidence_of(row))
        for row in rows
    ]


def evidence_of(row: dict[str, str]) -> Evidence:
    """The evidence that a row of the table holds."""
    told = [float(row[n]) > most for n, most in zip(SENSOR, MAX_WITHOUT, strict=True) if row[n]]
    if row["gps_kind"]:
        told.append(row["gps_kind"] == "many")
    several = float(row["share_several"]) if row["share_several"] else None
    trace = float(any(told)) if told else None
    own, grey = intensities_of(row)
    colour = float(float(row["rgb_distinct"]) > 1) if row["rgb_distinct"] else None
    return Evidence(several, trace, own, grey, colour)


def intensities_of(row: dict[str, str]) -> tuple[float | None, float | None]:
    """Whether intensities are a sensor's own, and whether they are the grey of the colours."""
    if not row["intensity_distinct"]:
        return None, None
    if float(row["intensity_distinct"]) <= 1:
        return 0.0, 0.0
    if not row["corr_int_grey"] or float(row["corr_int_grey"]) < SAME:
        return 1.0, 0.0
    painted = row["share_grey"] and float(row["share_grey"]) > SAME
    return (None, None) if painted else (0.0, 1.0)


def fitted(clouds: Sequence[Fingerprint]) -> Float64:
    """The weights of `NAMES` that suit some clouds best: logistic regression without a constant."""
    terms = np.array([cloud.terms for cloud in clouds])
    side = np.array([1.0 if cloud.matched else -1.0 for cloud in clouds])
    alike = Counter(cloud.producer for cloud in clouds)
    counts = np.array([alike[cloud.producer] ** -0.5 for cloud in clouds])
    for kind in (1, -1):
        counts[side == kind] *= len(clouds) / 2 / counts[side == kind].sum()

    def loss(weights: Float64) -> float:
        misses = np.logaddexp(0, -side * (terms @ weights))
        return float(counts @ misses + RIDGE / 2 * weights @ weights)

    found: Float64 = scipy.optimize.minimize(loss, np.zeros(len(NAMES))).x
    return found


def left_out(clouds: Sequence[Fingerprint]) -> list[float]:
    """The score of each cloud (above 0: matched) by the weights that all other producers' clouds give."""
    weights = {
        producer: fitted([cloud for cloud in clouds if cloud.producer != producer])
        for producer in {cloud.producer for cloud in clouds}
    }
    return [float(np.array(cloud.terms) @ weights[cloud.producer]) for cloud in clouds]


def right(clouds: Sequence[Fingerprint], scores: Sequence[float]) -> int:
    """How many clouds come out as what they are."""
    return sum(
        (score > 0) == cloud.matched for cloud, score in zip(clouds, scores, strict=True)
    )


def main() -> None:
    """Print the weights, and how many clouds they have right."""
    clouds = read(Path(sys.argv[1]))
    for name, weight in zip(NAMES, fitted(clouds), strict=True):
        print(f"{name:16}{weight:6.2f}")
    print(
        f"one producer left out: {right(clouds, left_out(clouds))} of {len(clouds)} clouds right"
    )
    chosen = [sum(piece.weight for piece in cloud.evidence.pieces()) for cloud in clouds]
    sure = sum((concluded(cloud.evidence.pieces()).sure or 0) >= 0.9 for cloud in clouds)
    print(
        f"the weights in use: {right(clouds, chosen)} right, {sure} of them with 90 % or more"
    )


if __name__ == "__main__":
    main()
