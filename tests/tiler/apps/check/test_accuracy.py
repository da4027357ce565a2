"""Checkpoints over a tilted plane, where every figure follows from the offsets."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import rasterio
from pyproj import Transformer

from tests.scenes.checkpoints import checkpoints, scattered
from tests.tiler.apps.check.rasters import tilted, write_surface
from tiler.apps.check import Checkpoints, PointOptions, check_dtm
from tiler.apps.check.accuracy import bilinear, min_points, pixel_places
from tiler.errors import ConfigError, InputError


def test_bilinear_is_exact_on_a_plane(tmp_path: Path) -> None:
    x, y = scattered(50)
    with rasterio.open(write_surface(tmp_path / "d.tif", tilted)) as raster:
        heights, outside = bilinear(raster, x, y)
    assert heights == pytest.approx(tilted(x, y), abs=1e-4)  # float32 heights
    assert not outside.any()


def test_bilinear_between_four_centres(tmp_path: Path) -> None:
    with rasterio.open(write_surface(tmp_path / "d.tif", lambda x, y: x * y)) as raster:
        heights, _ = bilinear(raster, np.array([7.75]), np.array([12.1]))
    weights = {
        (7.5, 11.5): 0.75 * 0.4,
        (8.5, 11.5): 0.25 * 0.4,
        (7.5, 12.5): 0.75 * 0.6,
        (8.5, 12.5): 0.25 * 0.6,
    }
    assert heights[0] == pytest.approx(
        sum(w * x * y for (x, y), w in weights.items()), rel=1e-6
    )


def test_points_without_a_height_are_counted(tmp_path: Path) -> None:
    path = write_surface(tmp_path / "d.tif", tilted, holes=((10, 10),))
    # On the hole, beside it with weight on it, on its neighbour's centre, in the outermost half
    # pixel, outside.
    x = np.array([10.5, 10.8, 11.5, 0.2, -3.0])
    y = np.array([29.5, 29.9, 29.5, 20.0, 20.0])
    facts = check_dtm(path, checkpoints(x, y, tilted(x, y)))
    assert (facts["points"], facts["used"], facts["no_height"], facts["outside"]) == (
        5,
        1,
        3,
        1,
    )
    assert [p["difference"] is None for p in facts["differences"]] == [
        True,
        True,
        False,
        True,
        True,
    ]
    assert facts["all"]["rmse"] == pytest.approx(0, abs=1e-4)


def test_figures_of_known_offsets(tmp_path: Path) -> None:
    x, y = scattered(40)
    offset = np.where(np.arange(40) < 30, 0.02, 0.3) * np.where(np.arange(40) % 2, 1, -1)
    offset[5] = 2.0
    kinds = ["NVA"] * 30 + ["VVA"] * 10
    path = write_surface(tmp_path / "d.tif", tilted)
    facts = check_dtm(
        path, checkpoints(x, y, tilted(x, y) - offset, kinds), PointOptions(rmse=0.05)
    )
    nva = offset[:30]
    assert facts["nva"]["rmse"] == pytest.approx(np.sqrt(np.mean(nva**2)), abs=1e-4)
    assert facts["nva"]["rmse_v"] == pytest.approx(
        math.hypot(np.sqrt(np.mean(nva**2)), 0.05), abs=1e-4
    )
    assert facts["nva"]["bias"] == pytest.approx(nva.mean(), abs=1e-4)
    assert facts["nva"]["median"] == pytest.approx(np.median(nva), abs=1e-4)
    assert (facts["nva"]["points"], facts["nva"]["outliers"], facts["vva"]["outliers"]) == (
        30,
        1,
        0,
    )
    assert facts["vva"]["rmse"] == pytest.approx(0.3, abs=1e-4)
    assert facts["vva"]["p95_abs"] == pytest.approx(0.3, abs=1e-4)
    assert [p["name"] for p in facts["differences"] if p["outlier"]][:1] == ["5"]
    assert facts["differences"][5]["difference"] == pytest.approx(2.0, abs=1e-4)
    statement = facts["asprs"]["statement"]
    assert f"RMSEV = {100 * facts['nva']['rmse_v']:.1f} cm with 30 checkpoints" in statement
    assert "the actual VVA accuracy RMSEV = 30.4 cm with 10" in statement


def test_too_few_points_make_no_statement(tmp_path: Path) -> None:
    x, y = scattered(29)
    asprs = check_dtm(
        write_surface(tmp_path / "d.tif", tilted),
        checkpoints(x, y, tilted(x, y)),
        PointOptions(rmse=0.02),
    )["asprs"]
    assert (asprs["enough_points"], asprs["least_points"], asprs["statement"]) == (
        False,
        30,
        None,
    )
    assert asprs["missing"] == ["29 NVA checkpoints, at least 30 are needed"]


@pytest.mark.parametrize(
    ("has_types", "rmse", "missing"),
    [
        (True, 0.02, []),
        (False, 0.02, ["give the type of each checkpoint (NVA or VVA) in a column `type`"]),
        (True, 0.0, ["give the checkpoints' own RMSE with --points-rmse"]),
    ],
)
def test_a_statement_needs_types_and_the_error_of_the_checkpoints(
    has_types: bool, rmse: float, missing: list[str], tmp_path: Path
) -> None:
    x, y = scattered(30)
    points = replace(checkpoints(x, y, tilted(x, y)), has_types=has_types)
    path = write_surface(tmp_path / "d.tif", tilted)
    asprs = check_dtm(path, points, PointOptions(rmse=rmse))["asprs"]
    assert asprs["missing"] == missing
    assert (asprs["statement"] is None) == bool(missing)


@pytest.mark.parametrize(
    ("offset", "noise", "is_constant"),
    [
        (-49.3, 0.02, True),  # ellipsoidal heights
        (1.1, 0.02, True),
        (0.9, 0.02, False),  # a bias that an odd DTM can have
        (5.0, 1.0, False),  # errors of vegetation, which differ from place to place
    ],
)
def test_a_constant_offset_is_reported_and_allows_no_statement(
    offset: float, noise: float, is_constant: bool, tmp_path: Path
) -> None:
    x, y = scattered(40)
    errors = offset + np.random.default_rng(2).normal(0, noise, 40)
    points = checkpoints(x, y, tilted(x, y) - errors)
    found = check_dtm(
        write_surface(tmp_path / "d.tif", tilted), points, PointOptions(rmse=0.02)
    )
    assert (found["asprs"]["statement"] is None) == is_constant
    if is_constant:
        assert found["asprs"]["missing"] == ["the heights have a constant offset"]
        assert str(found["constant_offset"]).startswith(f"constant offset of {offset:+.1f} m (")
        assert "another vertical datum or unit?" in str(found["constant_offset"])
    else:
        assert found["constant_offset"] is None


def test_two_checkpoints_do_not_show_a_constant_offset(tmp_path: Path) -> None:
    x, y = scattered(2)
    path = write_surface(tmp_path / "d.tif", tilted)
    assert check_dtm(path, checkpoints(x, y, tilted(x, y) + 9))["constant_offset"] is None


@pytest.mark.parametrize(
    ("x", "y", "message"),
    [
        (
            [5_300_010, 5_300_020],
            [500_010, 500_020],
            "(2) is inside the DTM, but 2 would be with x and y swapped; swap the columns",
        ),
        (
            [10, 20],
            [10, 20],
            "(2) is inside the DTM; give their CRS with --points-crs",
        ),
        (
            [500_010.5, 0],
            [5_300_029.5, 0],
            "(2) has a height of the DTM: 1 outside, 1 at nodata pixels;",
        ),
    ],
)
def test_checkpoints_without_any_height_are_refused(
    x: list[float], y: list[float], message: str, tmp_path: Path
) -> None:
    path = write_surface(
        tmp_path / "d.tif", tilted, west=500_000, south=5_300_000, holes=((10, 10),)
    )
    with pytest.raises(ConfigError, match=re.escape(message)):
        check_dtm(path, checkpoints(np.array(x), np.array(y), np.zeros(2)))


@pytest.mark.parametrize(
    ("area", "points"), [(0.1, 30), (1000, 30), (1001, 40), (2000, 40), (9500, 120), (1e6, 120)]
)
def test_larger_areas_need_more_points(area: float, points: int) -> None:
    assert min_points(area) == points


def test_land_covers_have_figures_of_their_own(tmp_path: Path) -> None:
    x, y = scattered(6)
    points = Checkpoints(
        np.array([x, y]),
        tilted(x, y) - np.array([0.1, 0.1, 0.4, 0.4, 0.4, 0.0]),
        ("NVA",) * 6,
        ("road", "road", "field", "field", "field", ""),
        tuple("abcdef"),
    )
    covers = check_dtm(write_surface(tmp_path / "d.tif", tilted), points)["land_cover"]
    assert {name: (c["points"], round(c["rmse"], 3)) for name, c in covers.items()} == {
        "field": (3, 0.4),
        "road": (2, 0.1),
    }


def test_points_of_another_crs_are_moved(tmp_path: Path) -> None:
    x, y = scattered(10)
    x, y = x + 500_000, y + 5_300_000
    path = write_surface(
        tmp_path / "d.tif",
        lambda x, y: tilted(x - 500_000, y - 5_300_000),
        west=500_000,
        south=5_300_000,
    )
    lon, lat = Transformer.from_crs("EPSG:25832", "EPSG:4258", always_xy=True).transform(x, y)
    points = checkpoints(lon, lat, tilted(x - 500_000, y - 5_300_000), crs="EPSG:4258")
    facts = check_dtm(path, points)
    assert (facts["used"], facts["outside"]) == (10, 0)
    assert facts["all"]["max_abs"] < 1e-3
    assert any("brought from ETRS89 into" in note for note in facts["notes"])
    # The option overrides the file.
    with pytest.raises(ConfigError, match="10. is inside the DTM; give their CRS"):
        check_dtm(path, points, PointOptions(crs="EPSG:25832"))


def test_feet_and_metres(tmp_path: Path) -> None:
    x, y = scattered(30)
    path = write_surface(tmp_path / "d.tif", tilted, crs="EPSG:2992", unit="foot")
    points = checkpoints(x, y, (tilted(x, y) - 1) * 0.3048)
    facts = check_dtm(path, points, PointOptions(unit=Fraction(1), rmse=0.3048))
    assert (facts["unit"], facts["metres_per_unit"]) == ("foot", 0.3048)
    assert facts["nva"]["rmse"] == pytest.approx(1.0, abs=1e-4)
    assert facts["nva"]["rmse_v"] == pytest.approx(math.sqrt(2), abs=1e-4)
    assert f"RMSEV = {math.sqrt(2) * 30.48:.1f} cm" in facts["asprs"]["statement"]


def test_unfit_checkpoints_are_refused(tmp_path: Path) -> None:
    points = checkpoints([1], [1], [1], crs="EPSG:4326")
    with pytest.raises(ConfigError, match="the DTM has no CRS"):
        check_dtm(write_surface(tmp_path / "d.tif", tilted, crs=None), points)
    with pytest.raises(
        ConfigError, match="in .EPSG:1., which is not a known CRS; give one with --points-crs"
    ):
        check_dtm(write_surface(tmp_path / "e.tif", tilted), points, PointOptions(crs="EPSG:1"))
    with pytest.raises(ConfigError, match="has no horizontal part"):
        check_dtm(tmp_path / "e.tif", points, PointOptions(crs="EPSG:5773"))
    with pytest.raises(InputError, match="cannot be read"):
        check_dtm(tmp_path / "absent.tif", points)


def test_a_point_at_infinity_is_on_no_pixel() -> None:
    columns, rows = pixel_places(
        (1.0, 0.0, 500.0, 0.0, -1.0, 900.0),
        np.array([np.inf, 510.0]),
        np.array([np.inf, 890.0]),
    )
    assert np.isnan(columns[0]) or np.isinf(columns[0])
    assert (columns[1], rows[1]) == (10, 10)
