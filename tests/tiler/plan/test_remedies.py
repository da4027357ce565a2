"""What a refusal names suffices: the same command with it is accepted."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.invariants import clouds
from tiler.config import RunConfig
from tiler.errors import ConfigError
from tiler.plan import Plan, make_plan


def square(path: Path, unit: float) -> Path:
    """Four points per m2 on 400 x 400 m, in units of so many metres."""
    xyz = np.random.default_rng(1).uniform(0, 1, (640_000, 3)) * [400.0, 400.0, 1.0]
    return clouds.write(
        path, clouds.Cloud(np.round(xyz / unit, 3), np.ones(len(xyz), np.uint8))
    )


@pytest.fixture(scope="module")
def wide(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return square(tmp_path_factory.mktemp("wide") / "wide.las", 1.0)


@pytest.fixture
def dear(monkeypatch: pytest.MonkeyPatch) -> None:
    """Points that cost so much that memory decides on tiles."""
    monkeypatch.setattr("tiler.plan.memory.VERTEX_BYTES", 8_000)


def planned(path: Path, out: Path | None = None, **settings: str) -> Plan:
    values = {"workers": 1, "in_process": True, "max_edge": "20", **settings}
    return make_plan([str(path)], RunConfig.from_mapping(values), out)


def refusal(path: Path, **settings: str) -> str:
    with pytest.raises(ConfigError) as refused:
        planned(path, **settings)
    return str(refused.value)


@pytest.mark.usefixtures("dear")
@pytest.mark.parametrize("method", ["auto", "classic"])
@pytest.mark.parametrize("memory", ["100MiB", "500MiB", "700MiB", "900MiB"])
def test_the_memory_that_is_named_suffices(wide: Path, method: str, memory: str) -> None:
    settings = (
        {"method": method, "tile_size": "400"} if method == "classic" else {"method": method}
    )
    text = refusal(wide, memory=memory, **settings)
    named = re.search(r"use --memory (\d+MiB)", text)
    assert named, text
    assert (
        planned(wide, memory=named[1], **settings).resources.memory
        == int(named[1].removesuffix("MiB")) << 20
    )


@pytest.mark.usefixtures("dear")
@pytest.mark.parametrize(("metres", "units", "unit"), [(1.0, "m", ""), (0.3048, "ft", "ft")])
def test_the_halo_that_is_named_suffices(
    metres: float, units: str, unit: str, tmp_path: Path
) -> None:
    wide = square(tmp_path / "wide.las", metres)
    settings = {"method": "classic", "memory": "700MiB", "units": units}
    text = refusal(wide, **settings, halo="200")
    named = re.search(rf" or --halo (\d+{unit}) --tile-size (\d+{unit})$", text)
    assert named, text
    assert 1 < planned(wide, **settings, halo=named[1], tile_size=named[2]).method.halo_m < 200


def test_pixels_far_too_fine_are_the_cause_not_the_coordinates(
    wide: Path, tmp_path: Path
) -> None:
    text = refusal(wide, resolution="0.0001")
    assert re.fullmatch(
        r"--resolution 0.0001 m: a single raster would have 1.6e\+13 pixels, but the points are 0.5 m apart; "
        r"use --resolution 1, or --sheets",
        text,
    )
    assert planned(wide, resolution="1").grid.resolution == 1


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        (
            {"resolution": "0.0001ft"},
            r"--resolution 0.0001 ft .* points are .* ft .*apart; use --resolution (.*), or",
        ),
        (
            {"sheets": "500"},
            r"--sheets 1,640 ft \(500 m\) is not a whole number of pixels of .* ft; use --sheets (.*) or another",
        ),
        (
            {"sheets": "1000ftx500m"},
            r"--sheets 1,640 ft \(500 m\) is not a whole number .*; use --sheets (1000ftx1640ft) or another",
        ),
    ],
)
def test_a_refusal_for_a_cloud_in_feet_has_feet_and_what_it_names_suffices(
    settings: dict[str, str], line: str, wide: Path
) -> None:
    text = refusal(wide, units="ft,ft", **settings)
    named = re.match(line, text)
    assert named, text
    assert named[1].endswith("ft")
    planned(wide, units="ft,ft", **dict.fromkeys(settings, named[1]))


def test_a_disk_too_small_for_fine_pixels(
    wide: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=1 << 30))
    with pytest.raises(
        ConfigError,
        match=r"MB are free; use --resolution 1 instead of 0.01, or free some space$",
    ):
        planned(wide, tmp_path / "out", resolution="0.01")
    assert planned(wide, tmp_path / "out").grid.resolution == 1
