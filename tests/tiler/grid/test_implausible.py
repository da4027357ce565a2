"""Results that cannot be true: thresholds of their warnings."""

from __future__ import annotations

from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import pytest

from tiler.core.lattice import Lattice
from tiler.core.raster import RasterSpec
from tiler.core.results import VoidsResult
from tiler.core.units import FOOT, METRE, Units
from tiler.grid.tasks.findings import report_implausible

SPEC = RasterSpec(Lattice(Fraction(1000)), 0, 512, 512, 512)
CELL, CELLS = 128, 16
"""Pixels along the side of a cell, and cells of the block: four squares of 256 m."""
LITTLE, BELOW, VOID = "too little ground", "terrain below all returns", "mostly void survey"


def warned(
    below: list[float], ground: int = 500, seen: float = 0.5, void: int = 0, metre: Fraction = METRE, **changes: Any
) -> list[Any]:  # fmt: skip
    """Return the implausible results of shares below all returns by square, and of ground in 1000 points."""
    n = int(seen * CELL**2)
    cells = [
        [r * CELL, c * CELL, n, round(n * below[2 * (r // 2) + c // 2])]
        for r in range(4)
        for c in range(4)
    ]
    config = SimpleNamespace(
        method="auto", canopy=changes.pop("canopy", "fill"), max_edge=Fraction(100)
    )
    parameters = {"roof_size_m": 200.0, "max_building_size_m": 36.0}
    voids = VoidsResult(surveyed_pixels=1000, pixels=void, asked_pixels=0, number=1, largest=[])
    labels = SimpleNamespace(points=1100, ground=ground, kept=100)
    job = SimpleNamespace(
        plan=SimpleNamespace(
            config=config,
            grid=SimpleNamespace(resolution=Fraction(1)),
            frame=SimpleNamespace(units=Units(metre, metre)),
            method=SimpleNamespace(parameters=parameters),
        ),
        results=SimpleNamespace(filter=labels, voids=voids),
        record=SimpleNamespace(failed=changes.pop("failed", [])),
        listener=lambda event: None,
    )
    vars(job.results).update(changes)
    report_implausible(job, SPEC, [{"cells": cells}])
    return job.results.implausible


@pytest.mark.parametrize(
    ("expected", "given"),
    [
        ([LITTLE], {"below": [0.995] * 4}),
        ([LITTLE], {"below": [0.95] * 4, "ground": 9}),
        ([], {"below": [0.95] * 4, "ground": 11}),
        ([], {"below": [0.85] * 4, "ground": 9}),  # A dense scan of a wood looks like this.
        ([BELOW], {"below": [0.0, 0.985, 0.5, 0.0]}),
        ([], {"below": [0.0, 0.975, 0.5, 0.0]}),
        ([], {"below": [0.0, 0.985, 0.5, 0.0], "seen": 0.3}),
        ([VOID], {"below": [0.0] * 4, "void": 500}),
        ([], {"below": [0.0] * 4, "void": 499}),
        ([], {"below": [0.0] * 4, "void": 500, "canopy": "void"}),
        ([], {"below": [1.0] * 4, "void": 500, "canopy_doubts": ["a canopy"]}),
        ([], {"below": [1.0] * 4, "void": 500, "failed": ["a tile"]}),
    ],
)
def test_thresholds(expected: list[str], given: dict[str, Any]) -> None:
    assert [result.what for result in warned(**given)] == expected


def test_worst_square_has_its_bounds() -> None:
    (result,) = warned([0.985, 0.0, 0.99, 0.0])
    assert result.bounds == [0.0, 0.0, 256.0, 256.0]
    assert "in 2 of 4 squares of 256 m" in result.why


def test_lengths_are_in_the_unit_of_the_crs() -> None:
    (result,) = warned([1.0] * 4, metre=FOOT)
    assert "more than 6.56 ft (2 m) above the terrain in 100.0% of the pixels" in result.why
