"""What the report says of standard errors: figures in the unit of the heights, and what they were fitted to."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import rasterio
from affine import Affine

from tests.tiler.report import results
from tiler.core.products import EDGES_M
from tiler.core.records import to_json
from tiler.grid.sigma import sigma_result
from tiler.report.accuracy import AtCheckpoints, at_checkpoints, rule_of_thumb, standard_errors


def text_of(run: dict, checked: AtCheckpoints | None = None) -> str:
    nodes = [
        node
        for node in [*rule_of_thumb(run, checked), *standard_errors(run)]
        if not isinstance(node, str) and node is not None
    ]
    return " ".join(" ".join(ElementTree.tostring(n, "unicode", "text").split()) for n in nodes)


def run_with(kind: str | None, vertical: float = 1.0) -> dict:
    empty = [0] * (len(EDGES_M) - 1)
    one = {
        "groups": {"open": [300, 300 * 100**2], "covered": [100, 100 * 500**2]},
        "histogram": {
            "open": [0] * 5 + [300] + empty[6:],
            "covered": [0] * 9 + [100] + empty[10:],
        },
    }
    none = {"groups": {}, "histogram": {}}
    units = {"horizontal": 1.0, "vertical": vertical}
    return {
        "plan": {"metres_per_unit": units},
        "sigma": to_json(sigma_result(kind, [one, none])),
    }


def test_each_kind_of_ground_has_its_rule_of_thumb() -> None:
    told = text_of(run_with("lidar"))
    assert "Rule of thumb for the RMSE of this terrain, m" in told
    assert "A rule of thumb, not a measurement" in told
    assert "scaled" not in told
    assert "checkpoint " not in told
    assert "0.100" in told
    assert "0.500" in told
    assert "75.0%" in told
    assert "water" not in told
    assert "27 LiDAR clouds" in told


def test_heights_in_feet_have_errors_in_feet() -> None:
    told = text_of(run_with("dim", 0.3048))
    assert "0.328" in told
    assert "1.640" in told
    assert "21 photogrammetric clouds" in told


def test_a_run_without_standard_errors_says_nothing_of_them() -> None:
    assert rule_of_thumb({"plan": {}}) == standard_errors({"plan": {}}) == []
    assert "both" in text_of(run_with(None))
    assert rule_of_thumb({"plan": {}, "sigma": to_json(sigma_result("dim", []))})


def test_rule_of_thumb_is_scaled_by_the_checkpoints() -> None:
    told = text_of(run_with("lidar"), AtCheckpoints(20, 0.3, 0.2))
    assert "scaled by checkpointsopen ground75.0%0.1000.150" in told
    assert "25.0%0.5000.750" in told
    assert "At 20 checkpoints the measured RMSE is 0.300 m" in told
    assert "times 1.50." in told
    assert "so few" not in told
    assert "so few checkpoints" in text_of(run_with("lidar"), AtCheckpoints(19, 0.3, 0.2))
    not_known = text_of(run_with("lidar"), AtCheckpoints(20, 0.3, None))
    assert "measured RMSE is 0.300 m. The rule of thumb is not known there" in not_known
    assert "scaled by" not in not_known


def test_rmse_and_rule_of_thumb_are_of_the_same_checkpoints(tmp_path: Path) -> None:
    sigma = np.full((4, 4), -9999, np.float32)
    sigma[0, :2] = 0.3, 0.4
    with rasterio.open(
        tmp_path / "sigma.tif", "w", driver="GTiff", height=4, width=4, count=1, dtype="float32",
        nodata=-9999, transform=Affine(1, 0, results.WEST, 0, -1, results.NORTH),
    ) as target:  # fmt: skip
        target.write(sigma, 1)
    places = ((0.5, 0.6), (1.5, -0.8), (2.5, 9.0), (9.5, 9.0), (1.5, None))  # east, difference
    points = [
        {"x": results.WEST + east, "y": results.NORTH - 0.5, "difference": difference}
        for east, difference in places
    ]
    check = {"accuracy": {"differences": points}}
    rasters = {"sigma": str(tmp_path / "sigma.tif")}
    both = at_checkpoints(check, rasters)
    assert both is not None
    assert both.points == 2
    assert both.measured == pytest.approx(2 * both.expected)
    alone = at_checkpoints(check, {})
    assert alone is not None
    assert (alone.points, alone.expected) == (4, None)
    assert at_checkpoints({**check, "older": True}, rasters) is None
    assert at_checkpoints({}, rasters) is None
