"""Papers' methods on matched clouds: what the robust start gives, and that neither tiles nor laser scans show it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ptd
from ptd.frame import Scale, Window
from ptd.matched import bent_hull, robust_cells, surface
from ptd.matched.robust_cells import NearGroundPass
from ptd.methods import METHODS, make_params
from ptd.passes import Points
from tests.benchmarks.scorecard_scenes import simulated
from tests.ptd.alike import alike
from tests.ptd.tiling import classify_tiled
from tests.scenes.village import NOISE_M, counts, village
from tiler.apps.evaluate import IGNORED, evaluate_labels

NAMES = ("chen2023", "dong2018", "ridge2016")
SCALE = Scale()


def errors(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Type I and II, without blunders."""
    return (found[truth == 2] != 2).mean(), (found[(truth == 5) | (truth == 6)] == 2).mean()


@pytest.mark.parametrize("name", NAMES)
def test_robust_cells_find_the_ground_that_lowest_points_lose(name: str) -> None:
    xyz, truth = village()
    wide = {"max_building_size": "40"}  # the hall
    lost, kept = errors(
        ptd.classify(xyz, name, make_params(name, wide), kind="dim").classification, truth
    )
    assert lost < 0.05
    assert kept < 0.02
    paper = make_params(name, wide | {"robust_cells": "no"})
    lowest, _ = errors(
        ptd.classify(xyz, name, paper, kind="dim", sigma=NOISE_M).classification, truth
    )
    assert lowest > 2 * lost


@pytest.mark.parametrize("name", NAMES)
def test_laser_scans_are_filtered_as_the_paper_has_it(name: str) -> None:
    xyz, _ = village()
    xyz = xyz[::6]
    paper = ptd.classify(xyz, name, make_params(name, {"robust_cells": "no"}))
    for kind in ("lidar", None):  # fewer than 4 points/m2 are taken for a laser scan
        found = ptd.classify(xyz, name, kind=kind)
        assert np.array_equal(found.classification, paper.classification)
        assert ("survey" in found.stats) == (kind is None)


@pytest.mark.parametrize("n", [0, 1, 2, 3, 7])
@pytest.mark.parametrize("name", NAMES)
def test_next_to_no_points_give_no_error(name: str, n: int) -> None:
    """Cells with a single point have no height: 7 points fill two cells."""
    places = [
        (5.0, 5.0),
        (8.0, 5.0),
        (5.0, 9.0),
        (5.1, 5.1),
        (8.1, 5.1),
        (8.2, 5.1),
        (5.2, 5.1),
    ]
    xyz = np.array([(x, y, 1.0) for x, y in places[:n]])
    assert len(ptd.classify(xyz.reshape(-1, 3), name, kind="dim").classification) == n


@pytest.fixture
def short_sighted(monkeypatch: pytest.MonkeyPatch) -> NearGroundPass:
    """The last pass with narrow facets and surroundings, so that small scenes have places beyond its reach."""
    monkeypatch.setattr(robust_cells, "MAX_CIRCUMRADIUS_M", 4.0)
    monkeypatch.setattr(bent_hull, "CONTRAST_M", 2.0)
    monkeypatch.setattr(surface, "NOISE_M", 2.0)
    monkeypatch.setattr(surface, "EXTENDED_M", (1.0, 2.0))
    reach_m = robust_cells.facet_reach_m() + surface.noise_reach_cells(1.0) + 3.0
    return replace(NearGroundPass(), influence_radius_m=reach_m)


@pytest.mark.parametrize("seed", range(6))
def test_nothing_beyond_the_reach_has_a_part(seed: int, short_sighted: NearGroundPass) -> None:
    """Cells of a lattice, whose circles all touch and whose edges run through cells; some are ground, some missing."""
    rng = np.random.default_rng(seed)
    side = 110
    row, column = np.divmod(np.flatnonzero(rng.random(side * side) < 0.8), side)
    hole = np.hypot(row - rng.integers(side), column - rng.integers(side)) < 7
    row, column = row[~hole], column[~hole]
    z = np.rint(rng.normal(0, 80, row.size) + 100 * column).astype(int)
    cells = np.stack([1000 * column + 500, 1000 * row + 500, z]).astype(np.int32)
    labels = np.where(rng.random(row.size) < rng.choice([0.1, 0.4, 0.9]), 2, 1).astype(np.uint8)
    core = Window(40_000, 44_000, 66_000, 61_000)
    reach = round(1000 * (short_sighted.influence_radius_m or 0.0))
    window = Window(
        core.west - reach, core.south - reach, core.east + reach, core.north + reach
    )
    seen = window.contains(cells[0], cells[1])
    assert seen.mean() < 0.75
    x, y = rng.integers(38_000, 68_000, (2, 20_000))
    height = 100 * x // 1000 + rng.normal(0, 500, x.size).astype(int)
    points = Points(np.stack([x, y, height]).astype(np.int32))
    own = core.contains(points.xyz[0], points.xyz[1])
    state = {"survey": {"kind": "dim", "cell_m": 1.0}, "places": alike(cell_sigma_m=0.08)}

    def found(which: np.ndarray) -> np.ndarray:
        given = Points(np.ascontiguousarray(cells[:, which]), labels[which])
        return short_sighted.fit(given, window, core, SCALE, state).label(points)[0][own]

    whole = found(np.ones(seen.size, bool))
    assert np.array_equal(found(seen), whole)
    assert 0.02 < (whole == 2).mean() < 0.98


@pytest.mark.parametrize(
    ("name", "halo_m"), [("chen2023", 40.0), ("dong2018", 60.0), ("ridge2016", 60.0)]
)
def test_tiles_do_not_show(name: str, halo_m: float, short_sighted: NearGroundPass) -> None:
    """What carries no mark is the untiled label, and some tiles carry none though they see but a part of the cloud."""
    params = METHODS[name].params(
        max_building_size_m=12.0 if name == "chen2023" else 8.0, rounds=2
    )

    class ShortSighted(type(params)):  # type: ignore[misc]
        passes = (*params.passes[:-1], short_sighted)

    points = counts(village()[0] + [0.0, 0.0, 30.0])
    told = {field: getattr(params, field) for field in params.__dataclass_fields__}
    whole, marks, state = classify_tiled(points, SCALE, ShortSighted(**told), None, kind="dim")
    assert not marks.any()
    assert 0.3 < (whole == 2).mean() < 0.95
    labels, marks, tiled = classify_tiled(
        points, SCALE, ShortSighted(**told), 23.0, halo_m, kind="dim"
    )
    assert not (~marks & (labels != whole)).any()
    assert (~marks).mean() > 0.3
    assert tiled["survey"] == state["survey"]


@pytest.mark.slow
def test_the_figures_of_the_paper_are_reached_on_scenes_like_its_own() -> None:
    """Dong 2018, table 4, means of areas 11 and 32: type I 4.28 %, total 6.26 %."""
    found = []
    for name in ("dim_area_city", "dim_area_suburb"):
        cloud = simulated(name)
        labels = ptd.classify(
            cloud.xyz, "dong2018", rgb=cloud.rgb, returns=cloud.returns
        ).classification
        ground = np.where(labels == 2, 2, 1).astype(np.uint8)
        figures = evaluate_labels(ground, cloud.classification, IGNORED)
        found.append([100 * figures["type_1"], 100 * figures["total"]])
    assert (np.mean(found, axis=0) < [4.28, 6.26]).all()
