"""Repeatability is the standard deviation of the noise of each swath, whatever the slope."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.tiler.apps.acceptance.pulses import Pulses, lattice
from tests.tiler.apps.acceptance.test_measuring import ASKED, FEET, rows
from tiler.apps.acceptance import Specification, read_specification
from tiler.apps.acceptance.counts import Cells
from tiler.apps.acceptance.separation import repeatability
from tiler.errors import ConfigError


def noisy(
    sigma_m: float, slope: float = 0.0, source: int = 1, is_random: bool = True
) -> Pulses:
    """120 x 80 m of a plane with normal noise, 4 pulses per square metre."""
    random = np.random.default_rng(source)
    x, y = random.uniform((0, 0), (120, 80), (38_400, 2)).T
    pulses = Pulses(x, y, source) if is_random else Pulses(*lattice(0, 120, 0, 80), source)
    noise = random.normal(0, sigma_m, pulses.x.size)
    pulses.z = 100 + slope * (0.8 * pulses.x + 0.6 * pulses.y) + noise
    return pulses


def precision(cloud: Pulses, folder: Path, **how: Any) -> Any:
    return rows(cloud.write(folder / "a.laz", **how), ASKED)["repeatability"]


@pytest.mark.parametrize("sigma_m", [0.005, 0.02, 0.06])
@pytest.mark.parametrize("slope", [0.0, 0.1])
@pytest.mark.parametrize("is_random", [True, False])
def test_repeatability_is_the_noise_of_a_plane(
    tmp_path: Path, sigma_m: float, slope: float, is_random: bool
) -> None:
    row = precision(noisy(sigma_m, slope, is_random=is_random), tmp_path)
    # 2400 cells of 16 points: the median of their deviations has an error of 0.5 %.
    assert row["found"] == pytest.approx(sigma_m, rel=0.02)


def test_the_worst_swath_and_its_worst_area_are_named(tmp_path: Path) -> None:
    calm, rough = noisy(0.01), noisy(0.02, 0.1, source=2)
    in_area = (abs(rough.x - 80) < 16) & (abs(rough.y - 40) < 16)
    rough.z[in_area] += np.random.default_rng(5).normal(0, 0.03, int(in_area.sum()))
    row = precision(calm + rough, tmp_path)
    assert row["remark"] == "2 swaths"
    assert [text.partition(":")[0] for text in row["where"]] == [
        "point source 2",
        "point source 1",
    ]
    # A tenth of the cells has more noise, which moves the median a little.
    assert row["found"] == pytest.approx(0.02, rel=0.04)
    place, worst = row["where"][0].partition("worst around ")[2].split(" (")
    x, y = (float(text) for text in place.split())
    assert abs(x - 500_080) < 32
    assert abs(y - 5_000_040) < 32
    assert float(worst.split()[0]) > 2.6


def test_plants_and_steep_ground_do_not_count(tmp_path: Path) -> None:
    cloud = noisy(0.02)
    wild = cloud.x > 70
    cloud.z[wild] += np.random.default_rng(1).uniform(0, 5, int(wild.sum()))
    cloud.z[cloud.x < 20] -= 0.5 * (20 - cloud.x[cloud.x < 20])
    assert precision(cloud, tmp_path)["found"] == pytest.approx(0.02, rel=0.03)


def test_feet_give_metres(tmp_path: Path) -> None:
    cloud = noisy(0.02, 0.1)
    cloud.z = cloud.z / FEET
    row = precision(cloud, tmp_path, crs="EPSG:2994", metres=FEET)
    assert row["found"] == pytest.approx(0.02, rel=0.02)


def test_a_limit_may_be_asked_and_rough_clouds_are_not_measured(tmp_path: Path) -> None:
    asked = Specification("made", {"pulse_spacing": 0.5, "repeatability": 0.03})
    states = [
        rows(noisy(sigma_m).write(tmp_path / "a.laz"), asked)["repeatability"]["state"]
        for sigma_m in (0.02, 0.04, 1.0)
    ]
    assert states == ["pass", "fail", "not measured"]


def test_deviations_are_those_of_planes_of_least_squares() -> None:
    random = np.random.default_rng(3)
    n, side, lattice_side = 12_000, 2.0, 1.0
    x, y = random.uniform(0, 60, (2, n))
    z = np.round(100 + 0.1 * x - 0.05 * y + random.normal(0, 0.02, n), 3)
    cells = Cells.around(30.0, 30.0, lattice_side)
    keys, sums = cells.of_heights.height_sums(x, y, z, np.full(n, 7, np.uint16))
    [found], others = repeatability(keys, sums, np.zeros(keys.size, np.uint8), cells.of_heights)
    variances = []
    for column in range(30):
        for row in range(30):
            mine = (x // side == column) & (y // side == row)
            freedom = int(mine.sum()) - 3
            if freedom < 5:
                continue
            plane = np.stack((x[mine], y[mine], np.ones(freedom + 3)), 1)
            squares = np.linalg.lstsq(plane, z[mine])[1][0]
            variances.append(squares / freedom / (1 - 2 / (9 * freedom)) ** 3)
    assert (found.source, found.cells, others) == (7, len(variances), [])
    assert found.sigma_m == pytest.approx(np.sqrt(np.median(variances)), rel=1e-3)


def test_a_swath_without_enough_even_cells_is_named_and_nothing_passes(tmp_path: Path) -> None:
    asked = Specification("made", {"pulse_spacing": 0.5, "repeatability": 0.03})
    cloud = noisy(0.02) + noisy(0.5, source=2)
    row = rows(cloud.write(tmp_path / "a.laz"), asked)["repeatability"]
    assert row["state"] == "not measured"
    assert row["remark"].startswith("1 swath without 30 even cells")
    assert row["remark"].endswith("point sources 2")
    assert row["where"][0].startswith("point source 1: 2.0")


def test_a_limit_above_what_even_cells_show_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "spec.toml"
    file.write_text("repeatability = 0.1\n")
    with pytest.raises(ConfigError, match=r"must be 0\.08 m or below"):
        read_specification(str(file))
