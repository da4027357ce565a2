"""Wrong choices that the data show have one warning with its remedy; choices that may be right have none."""

from __future__ import annotations

from typing import Any

import pytest

from ptd.matched.evidence import Finding
from tests.tiler.conftest import MakeCloud
from tests.tiler.plans import changed
from tiler.apps.info import describe
from tiler.config import RunConfig
from tiler.core.lattice import Bounds
from tiler.plan import make_plan, plan_json
from tiler.plan.warnings import preflight_warnings, warnings_of

MATCHED, LASER = Finding("dim", 0.9, "colours"), Finding("lidar", 0.9, "returns")


def wide(counts: int) -> Bounds:
    """Return square bounds in the area of the CRS of `make_cloud`."""
    x, y = 500_000_000, 5_400_000_000
    return Bounds(x, y, x + counts, y + counts)


@pytest.mark.parametrize(
    ("made", "settings", "density", "words"),
    [
        (MATCHED, {}, 1.0, ["look like image matching", "method classic", "use --preset dim"]),
        (MATCHED, {"method": "ridge2016"}, 1.0, ["method ridge2016 is made for LiDAR"]),
        (LASER, {}, 8.0, []),
        (None, {}, 8.0, []),  # their fields do not say it
        (MATCHED, {"method": "dong2018"}, 40.0, []),
        (MATCHED, {"method": "keep"}, 40.0, []),
        (
            None,
            {"resolution": "0.5"},
            1.0,
            ["--resolution 0.5 m is finer", "point spacing of 1 m", "use --resolution 1"],
        ),
        (None, {"resolution": "0.5"}, 3.0, []),
        (
            None,
            {"halo": "10"},
            3.0,
            ["--halo 10 m is too small", "leave it out, or use --halo 100"],
        ),
        (None, {"halo": "60"}, 3.0, []),
        (None, {}, 0.1, []),
    ],
)
def test_choices(
    made: Finding | None, settings: dict[str, Any], density: float, words: list[str]
) -> None:
    config = RunConfig.from_mapping({"method": "classic", **settings})
    found = list(preflight_warnings(config, made, density, 100.0))
    assert len(found) == bool(words)
    for word in words:
        assert word in found[0]


def test_the_plan_gives_the_advice(make_cloud: MakeCloud) -> None:
    path = make_cloud("b.las", 2000, 1)
    config = RunConfig.from_mapping({"method": "classic", "halo": "10", "resolution": "0.1"})
    warnings = make_plan([str(path)], config).warnings
    assert sum("--halo 10 m is too small" in text for text in warnings) == 1
    assert sum("is finer than the point spacing" in text for text in warnings) == 1


@pytest.mark.parametrize(("memory", "warned"), [(8 << 30, False), (1 << 30, True)])
def test_little_memory_is_told_of_where_halos_multiply_the_work(
    memory: int, warned: bool, make_cloud: MakeCloud
) -> None:
    """A user who did not choose the tiles need not choose them, and many workers are no reason to warn."""
    plan = make_plan([str(make_cloud())], RunConfig(kind="dim", in_process=True))
    extent = wide(9_000_000)
    plan = changed(plan, extent=extent, points=800_000_000, covered_m2=81e6)
    for workers in (1, 64):
        found = warnings_of(changed(plan, tile_memory=memory, tile_workers=workers))
        assert len(found) == warned
        for text in found:
            assert text.startswith("tiles that fit into 1,024 MiB of memory, with up to 678 m")
            assert text.endswith("times the work; use more --memory")


@pytest.mark.parametrize(
    ("side", "tile", "times"),
    [(90, 128, None), (900, 512, None), (900, 128, "6.6"), (300, 100, "9.0")],
)
def test_small_tiles_are_told_of_where_there_are_several(
    side: int, tile: int, times: str | None, make_cloud: MakeCloud
) -> None:
    settings = {"method": "classic", "tile_size": tile, "halo": 100, "in_process": True}
    plan = make_plan([str(make_cloud())], RunConfig.from_mapping(settings))
    found = warnings_of(changed(plan, extent=wide(1000 * side)))
    assert [
        f"need {times} times the work; leave out --tile-size, or use --tile-size 483" in text
        for text in found
    ] == ([True] if times else [])


@pytest.mark.parametrize(("crs", "told"), [("EPSG:3857", 1), ("EPSG:25832", 0)])
def test_a_crs_that_stretches_lengths_is_told_of(
    crs: str, told: int, make_cloud: MakeCloud
) -> None:
    plan = make_plan([str(make_cloud(crs=crs))], RunConfig.from_mapping({"in_process": True}))
    found = [text for text in plan.warnings if "times those on the ground" in text]
    assert len(found) == told
    assert all("are 1.38 times those on the ground" in text and "UTM" in text for text in found)


@pytest.mark.parametrize(
    ("header", "option", "told"),
    [
        (None, "EPSG:32631", 1),
        ("EPSG:32631", None, 1),
        (None, "EPSG:28992", 0),
        ("EPSG:28992", None, 0),
        (None, "none", 0),
    ],
)
def test_coordinates_of_another_crs_are_told_of_with_their_place(
    header: str | None, option: str | None, told: int, make_cloud: MakeCloud
) -> None:
    path = make_cloud(crs=header, offsets=(85_000.0, 447_500.0, 0.0))
    plan = make_plan([str(path)], RunConfig(crs=option, in_process=True))
    found = [text for text in plan.warnings if "area of use" in text]
    assert len(found) == told
    assert all("at 4.04° N, 0.74° W" in text and "UTM zone 31N" in text for text in found)
    facts = describe(str(path))
    assert len(facts["warnings"]) == bool(header and told)


@pytest.mark.parametrize(
    ("header", "option", "text"),
    [
        ("EPSG:25832+5783", None, "declared by the files"),
        (
            "EPSG:25832",
            None,
            "declared by the files for x and y, assumed to be the same for heights",
        ),
        (None, "EPSG:25832+5783", "declared by --crs"),
        (None, "none", "assumed, because the files have no CRS"),
    ],
)
def test_a_plan_tells_which_units_are_assumed(
    header: str | None, option: str | None, text: str, make_cloud: MakeCloud
) -> None:
    plan = make_plan([str(make_cloud(crs=header))], RunConfig(crs=option, in_process=True))
    assert plan_json(plan)["units_from"] == text


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"resolution": "500"}, "the terrain has only 1 x 1 pixels of 500 m; use a smaller"),
        ({"resolution": "10", "sheets": "500", "sheet_name": "{name}_{x}_{y}a"}, None),
        ({"sheet_name": "{name}_{x}_{y}a"}, "--sheet-name has no effect without --sheets"),
        ({"product_name": "dtm=MNT"}, None),
        (
            {"product_name": "dtm=MNT", "sheets": "500", "sheet_name": "{x}_{y}"},
            "--product-name has no effect if --sheet-name has no {name}",
        ),
        ({}, None),
    ],
)
def test_settings_without_use_are_told_of(
    settings: dict[str, str], text: str | None, make_cloud: MakeCloud
) -> None:
    settings = {"method": "classic", "in_process": True, **settings}
    plan = make_plan([str(make_cloud())], RunConfig.from_mapping(settings))
    found = warnings_of(changed(plan, extent=wide(300_000)))
    assert [warning.startswith(text or "") for warning in found] == ([True] if text else [])
