"""What the report says of standard errors: figures in the unit of the heights, and what they were fitted to."""

from __future__ import annotations

from xml.etree import ElementTree

from tiler.core.records import to_json
from tiler.core.sigma_groups import EDGES_M
from tiler.grid.records import SigmaRecord
from tiler.grid.sigma import sigma_result
from tiler.report.expected import expected


def text_of(run: dict) -> str:
    nodes = [node for node in expected(run) if not isinstance(node, str) and node is not None]
    return " ".join(" ".join(ElementTree.tostring(n, "unicode", "text").split()) for n in nodes)


def run_with(kind: str | None, vertical: float = 1.0) -> dict:
    empty = [0] * (len(EDGES_M) - 1)
    one = SigmaRecord(
        filled=400,
        groups={"open": [300, 300 * 100**2], "covered": [100, 100 * 500**2]},
        histogram={
            "open": [0] * 5 + [300] + empty[6:],
            "covered": [0] * 9 + [100] + empty[10:],
        },
    )
    none = SigmaRecord(filled=0, groups={}, histogram={})
    units = {"horizontal": 1.0, "vertical": vertical}
    return {
        "plan": {"metres_per_unit": units},
        "sigma": to_json(sigma_result(kind, [one, none])),
    }


def test_each_kind_of_ground_has_its_expected_rmse() -> None:
    told = text_of(run_with("lidar"))
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
    assert expected({"plan": {}}) == []
    assert "both" in text_of(run_with(None))
    assert expected({"plan": {}, "sigma": to_json(sigma_result("dim", []))})
