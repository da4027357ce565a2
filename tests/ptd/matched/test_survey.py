"""What tells a laser scan from a matched cloud where returns or the noise of flat places decide."""

from __future__ import annotations

import numpy as np
import pytest

import ptd
from ptd.frame import Scale, Window
from ptd.matched.survey import SurveyPass
from ptd.passes import Points


@pytest.mark.parametrize(
    ("sigma_m", "kind"), [(0.02, "laser scanning"), (0.07, "image matching")]
)
def test_flat_places_of_a_bare_town_tell_a_laser_from_a_matcher(
    sigma_m: float, kind: str
) -> None:
    """120 m x 120 m at 2 points/m2: 16 houses of 14 m x 12 m on a slope, terraces of 1 m, single returns."""
    rng = np.random.default_rng(1)
    x, y = 120 * rng.random((2, 28_800))
    z = 0.05 * x + np.floor(y / 40)
    house = (x % 30 >= 8) & (x % 30 < 22) & (y % 30 >= 8) & (y % 30 < 20)
    xyz = np.stack([x, y, z + 7.0 * house + rng.normal(0, sigma_m, x.size)], axis=1)
    found = ptd.classify(xyz)
    assert f"decided: {kind}" in found.decisions["statistics"]["notes"][0]
    assert (found.classification[~house] == 2).mean() > 0.98
    assert not (found.classification[house] == 2).any()


@pytest.mark.parametrize(
    ("core", "several", "looks"), [(2**40, 1, 0), (2**40, 0, 9), (9_000, 1, 9)]
)
def test_what_is_seen_through_is_counted_unless_returns_of_the_whole_run_tell(
    core: int, several: int, looks: int
) -> None:
    """A point in each of nine cells of 2 m, one of several returns or none; a tile does not know the run's others."""
    x, y = (
        np.ascontiguousarray(v.ravel(), np.int32)
        for v in np.mgrid[1000:6000:2000, 1000:6000:2000]
    )
    returns = np.ones((2, 9), np.uint8)
    returns[1, 4] += several
    window = Window(-core, -core, core, core)
    model = SurveyPass().fit(
        Points(np.stack([x, y, x]), returns=returns),
        window,
        window,
        Scale(),
        {"run": {"kind": None}},
    )
    partial = model.partial()
    assert (partial["told"], partial["several"], partial["looks"]) == (9, several, looks)


@pytest.mark.parametrize(
    ("side", "core", "wide"), [(2.0, 2**40, 0), (1.0, 2**40, 9), (2.0, 12_000, 9)]
)
def test_wide_cells_are_counted_unless_the_whole_run_is_dense(
    side: float, core: int, wide: int
) -> None:
    """``side`` squared points a square metre, on 12 x 12 m; a tile does not know how dense the run is."""
    x, y = (
        v.ravel().astype(np.int32)
        for v in np.mgrid[0 : 12_000 : 1000 / side, 0 : 12_000 : 1000 / side]
    )
    window = Window(-core, -core, core, core)
    points = Points(np.stack([x, y, np.zeros_like(x)]), returns=np.zeros((2, x.size), np.uint8))
    partial = (
        SurveyPass().fit(points, window, window, Scale(), {"run": {"kind": None}}).partial()
    )
    assert (partial["looks"], partial["wide_looks"]) == (36, wide)


@pytest.mark.parametrize(("kind", "doubted"), [("dim", True), ("lidar", False)])
def test_a_kind_given_by_the_user_is_checked_by_positions_if_fields_do_not_decide(
    kind: str, doubted: bool
) -> None:
    """40 m x 40 m at 10 points/m2; a quarter of the points are 3 to 6 m above the ground, in plants."""
    rng = np.random.default_rng(3)
    x, y = 40 * rng.random((2, 16_000))
    z = np.where(
        np.arange(x.size) % 4 == 1, 3 + 3 * rng.random(x.size), rng.normal(0, 0.02, x.size)
    )
    evidence = ptd.Evidence(own_intensity=1.0, grey_intensity=0.0, colour=1.0)
    found = ptd.classify(np.stack([x, y, z], axis=1), kind=kind, evidence=evidence)
    survey = found.decisions["statistics"]["survey"]
    assert (survey["kind"], survey["sure"]) == (kind, None)
    assert (survey["looks_like"] is not None) is doubted
    if doubted:
        assert survey["looks_like"].startswith("laser scanning (9")
        assert "pulses passed through plants" in survey["looks_like"]
