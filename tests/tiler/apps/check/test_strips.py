"""Strips with known offsets."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest

from tests.tiler.apps.check.rasters import tilted
from tiler.apps.check import strip_differences
from tiler.errors import InputError
from tiler.io.las import reader


def write_strips(
    path: Path, offsets: dict[int, float], classes: int = 2, steep: float = 0.0
) -> Path:
    """Strips 30 m wide, 20 m apart, 20 m long, of 4 points/m2 over a gentle plane, each with an offset."""
    rng = np.random.default_rng(9)
    parts = []
    for number, (strip, offset) in enumerate(offsets.items()):
        x, y = rng.uniform(0, 30, 2400) + 20 * number, rng.uniform(0, 20, 2400)
        z = tilted(x, y) * 0.1 + offset + steep * x
        parts.append(np.stack((x, y, z, np.full(2400, strip))))
    x, y, z, strip = np.concatenate(parts, axis=1)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, 0.001)
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = x, y, z
    cloud.point_source_id = strip.astype(np.uint16)
    cloud.classification = np.full(x.size, classes, np.uint8)
    cloud.write(path)
    return path


@pytest.mark.parametrize("bytes_at_once", [1 << 27, 20_000])
def test_offsets_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bytes_at_once: int
) -> None:
    monkeypatch.setattr(reader, "BYTES_PER_BATCH", bytes_at_once)
    facts = strip_differences(
        [write_strips(tmp_path / "a.laz", {11: 0.0, 12: 0.05, 14: -0.02})]
    )
    assert facts["strips"] == {"11": 2400, "12": 2400, "14": 2400}
    assert [(p["first"], p["second"]) for p in facts["pairs"]] == [(11, 12), (12, 14)]
    first, second = facts["pairs"]
    assert first["median"] == pytest.approx(0.05, abs=0.01)
    assert second["median"] == pytest.approx(-0.07, abs=0.01)
    assert 40 <= first["cells"] <= 50  # 10 m x 20 m in cells of 2 m
    assert facts["cells"] == first["cells"] + second["cells"]
    assert facts["all"]["rmse"] == pytest.approx(np.hypot(0.05, 0.07) / np.sqrt(2), abs=0.01)


def test_files_share_strips(tmp_path: Path) -> None:
    one, other = (write_strips(tmp_path / f"{k}.laz", {k: z}) for k, z in ((7, 0.0), (8, 0.1)))
    facts = strip_differences([one, other])
    assert [(p["first"], p["second"]) for p in facts["pairs"]] == [(7, 8)]
    assert facts["all"]["median"] == pytest.approx(0.1, abs=0.01)


def test_steep_cells_are_left_out(tmp_path: Path) -> None:
    facts = strip_differences([write_strips(tmp_path / "a.laz", {1: 0.0, 2: 0.05}, steep=0.5)])
    assert facts["cells"] == 0
    assert facts["rough"] >= 40
    assert facts["all"]["rmse"] is None


def test_a_single_strip_has_no_differences(tmp_path: Path) -> None:
    facts = strip_differences([write_strips(tmp_path / "a.laz", {0: 0.0})])
    assert (facts["strips"], facts["pairs"], facts["cells"]) == ({"0": 2400}, [], 0)


def test_without_ground_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no ground"):
        strip_differences([write_strips(tmp_path / "a.laz", {1: 0.0}, classes=1)])
