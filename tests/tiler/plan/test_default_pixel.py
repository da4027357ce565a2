"""The default pixel: that of laser scans, of sparse clouds, and of dense matched ones."""

from __future__ import annotations

from fractions import Fraction

import pytest

from tiler.config import RunConfig
from tiler.core.units import FOOT, METRE, US_SURVEY_FOOT
from tiler.plan.sizes import resolution_of


@pytest.mark.parametrize(
    ("density", "kind", "unit", "pixel"),
    [
        (2000.0, "lidar", METRE, Fraction(1)),
        (2000.0, None, METRE, Fraction(1)),  # it is not sure that it is matched
        (2000.0, "dim", METRE, Fraction(1, 10)),
        (160.0, "dim", METRE, Fraction(1, 4)),
        (76.0, "dim", METRE, Fraction(1, 2)),
        (24.0, "dim", METRE, Fraction(1)),
        (0.3, "dim", METRE, Fraction(2)),
        (76.0, "dim", FOOT, 2 * FOOT),
        (110.0, "dim", FOOT, FOOT),
        (2000.0, "dim", FOOT, FOOT / 2),
        (24.0, "dim", FOOT, 2 * FOOT),
        (2500.0, "dim", FOOT, FOOT / 5),
        (30_000.0, "dim", FOOT, FOOT / 10),
        (20.0, "lidar", FOOT, 2 * FOOT),
        (0.5, "lidar", FOOT, 5 * FOOT),
        (0.2, "lidar", US_SURVEY_FOOT, 10 * US_SURVEY_FOOT),
        (0.01, "lidar", FOOT, 40 * FOOT),
    ],
)
def test_it_follows_the_density_of_matched_clouds(
    density: float, kind: str | None, unit: Fraction, pixel: Fraction
) -> None:
    notes: list[str] = []
    assert resolution_of(RunConfig(), density, kind, unit, notes) == pixel
    (note,) = notes
    usual = 1 if unit == 1 else 2 * unit
    by_density = pixel != usual or (unit != 1 and density * pixel**2 >= 9 and kind == "dim")
    assert ("the default for clouds of this density" in note) == (not by_density)
    said = RunConfig(resolution=Fraction(3))
    assert resolution_of(said, density, kind, unit, notes) == 3
    assert notes == [note]
