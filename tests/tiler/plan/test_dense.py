"""Places far denser than the rest: the plan sees them, and decides for the whole run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.invariants import clouds
from tiler.config import RunConfig
from tiler.errors import ConfigError
from tiler.plan import Plan, make_plan, projected_memory
from tiler.plan.memory import BASE_BYTES

SPOT_M2 = 30.0**2


def scattered(points: int, side: float, corner: float = 0.0) -> clouds.Cloud:
    xyz = np.random.default_rng(points).uniform(0, side, (points, 3)) + [corner, corner, 0]
    return clouds.Cloud(np.round(xyz * [1, 1, 0.01], 3), np.ones(points, np.uint8))


@pytest.fixture(scope="module")
def wide(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return clouds.write(tmp_path_factory.mktemp("wide") / "wide.las", scattered(40_000, 500.0))


@pytest.fixture(scope="module")
def spot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return clouds.write(
        tmp_path_factory.mktemp("spot") / "spot.las", scattered(36_000, SPOT_M2**0.5, 80.0)
    )


def planned(*paths: Path, **settings: str | dict[str, str]) -> Plan:
    """With parts of blocks that see 52 m."""
    values = {
        "max_edge": "9.9",
        "resolution": "1",
        "memory": "1GiB",
        "method": "classic",
        **settings,
    }
    return make_plan([str(path) for path in paths], RunConfig.from_mapping(values))


def test_one_dense_place_is_enough_to_thin(
    wide: Path, spot: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tiler.plan.model.MAX_GROUND", 10_000)
    alone, both = planned(wide), planned(wide, spot)
    assert not alone.thin_ground
    assert both.thin_ground
    assert alone.max_part_points < 3 * 52**2
    assert 10_000 < both.max_part_points <= (4 * 52.0) ** 2


def test_no_part_has_more_points_than_the_cloud(
    spot: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The window of a part is 330 m wide, so with the density of the cloud it would have 4 million points."""
    for limit, thin in ((30_000, True), (40_000, False)):
        monkeypatch.setattr("tiler.plan.model.MAX_GROUND", limit)
        plan = planned(spot, max_edge="100")
        assert plan.thin_ground is thin
        assert plan.max_part_points == plan.max_bucket_points == 36_000


def test_candidates_are_those_of_the_method(wide: Path) -> None:
    """Finer ones would only be read, never used; where buckets are not made of its cells, the usual ones are."""
    for cell, fine in (("1", 1.0), ("0.25", 0.25), ("2", 2.0), ("0.3", 0.5), ("0.7", 0.5)):
        plan = planned(wide, parameters={"thin_cell": cell})
        assert (plan.grid.fine_m, plan.on_candidates) == (fine, cell not in ("0.3", "0.7"))


def test_ground_beside_objects_is_left_out_before_it_is_thinned(spot: Path) -> None:
    """A drone's cloud at a quarter metre: what a part holds is bounded by its cells, not by the points."""
    plan = planned(spot, surface="median", erode="0.5", resolution="0.02", max_edge="0.5")
    cells = (32 * 0.02 + 2 * 0.505) / 0.01
    assert plan.max_part_points <= cells**2
    dense = planned(spot, surface="median", erode="0.5", resolution="0.5", max_edge="0.5")
    assert dense.max_part_points == pytest.approx((2 * (32 * 0.5 + 2 * 0.505) / 0.5) ** 2)


def test_a_resolution_that_is_no_exact_one_is_refused_as_such(spot: Path) -> None:
    """Not as the raster of 1e17 pixels that it would make."""
    for resolution in ("0.0000001", "70km"):
        with pytest.raises(ConfigError, match=r"^--resolution \S+ m: "):
            planned(spot, resolution=resolution, max_edge="99km")


def test_a_part_that_cannot_fit_is_refused_with_what_helps(
    wide: Path, spot: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = projected_memory(planned(wide, spot))
    for module in ("model", "estimates"):
        monkeypatch.setattr(f"tiler.plan.{module}.GROUND_BYTES", 100_000)
    monkeypatch.setattr("tiler.plan.model.MAX_GROUND", 60_000)
    with pytest.raises(
        ConfigError, match=r"grid needs .* MiB per worker, .*MiB or a smaller --max-edge"
    ):
        planned(wide, spot)
    fits = projected_memory(planned(wide, spot, memory="4GiB", max_edge="5"))
    assert BASE_BYTES < before["grid"] < fits["grid"] <= 4 << 30


def test_what_is_written_is_projected(spot: Path) -> None:
    export = projected_memory(planned(spot))["export"]
    assert BASE_BYTES + 36_000 < export < 512 << 20


def test_workers_that_no_machine_can_hold_are_refused(wide: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"--workers 1000000: each needs \d+ MiB .* use --workers \d+"
    ):
        make_plan([str(wide)], RunConfig(method="classic", workers=1_000_000))
    assert make_plan([str(wide)], RunConfig(method="classic", workers=1)).resources.workers == 1


def test_keep_without_a_class_to_grid_is_refused(wide: Path) -> None:
    with pytest.raises(ConfigError, match="--ground-classes none"):
        make_plan([str(wide)], RunConfig(method="keep", ground_classes=()))
