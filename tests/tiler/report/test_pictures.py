"""Pictures: what a colour means is where it must be, and all of them stay small."""

from __future__ import annotations

import base64
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import MemoryFile

from tests.tiler.report import results
from tiler.core.products import PRODUCTS
from tiler.report import pictures
from tiler.report.pictures import TERRAIN, VIRIDIS, Picture, draw, ramp_colour

ALL = {"dtm.tif": 1, "density.tif": 1, "mask.tif": 1}


def rgba(picture: Picture) -> np.ndarray:
    """Pixels of a picture, uint8 (height, width, 4)."""
    data = base64.b64decode(picture.uri.removeprefix("data:image/png;base64,"))
    table = np.zeros((256, 4), np.uint8)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with MemoryFile(data) as memory, memory.open() as png:
            for value, colour in png.colormap(1).items():
                table[value] = colour
            return table[png.read(1)]


def drawn(tmp_path: Path, rows: int = 40, columns: int = 60) -> dict[str, Picture]:
    out = results.write(tmp_path / "out", results.run(outputs=ALL), rows, columns)
    found = draw({name.removesuffix(".tif"): out / name for name in ALL}, results.run())
    assert found is not None
    assert found.extent == (
        results.WEST,
        results.NORTH - rows,
        results.WEST + columns,
        results.NORTH,
    )
    return {picture.name: picture for picture in found.pictures}


def test_what_has_no_value_is_transparent(tmp_path: Path) -> None:
    found = drawn(tmp_path)
    assert set(found) == {"hillshade", "dtm", "density", "mask"}
    for name, picture in found.items():
        opacity = rgba(picture)[..., 3]
        assert opacity.shape == (40, 60)
        assert (opacity[:, 30:] == 0).all()
        assert (opacity[:, :29] == 255).all(), name


def test_colours_are_those_of_the_legend(tmp_path: Path) -> None:
    found = drawn(tmp_path)
    mask = rgba(found["mask"])
    for row in range(4):
        assert tuple(mask[row, 5, :3]) == PRODUCTS["mask"].colours[1 + row]
    heights = rgba(found["dtm"])[..., :3].astype(int)
    values = results.raster("dtm", 40, 60)
    low, high = (
        tuple(heights[np.unravel_index(f(values[:, :30]), (40, 30))])
        for f in (np.argmin, np.argmax)
    )
    assert (low, high) == (TERRAIN[0], TERRAIN[-1])
    assert found["dtm"].legend[0][1].endswith(" ft")
    density = [(colour, text) for colour, text in found["density"].legend]
    assert density == [(VIRIDIS[i], t) for i, t in enumerate(("1", "2", "4", "8", "16"))]


def test_slopes_to_the_north_west_are_lit(tmp_path: Path) -> None:
    y, x = np.mgrid[:40, :60]
    results.write_raster(
        tmp_path / "dtm.tif", -np.hypot(x - 30, y - 20).astype(np.float32) + 100
    )
    found = draw({"dtm": tmp_path / "dtm.tif"}, results.run())
    assert found is not None
    shade = rgba(found.pictures[0])[..., 0].astype(int)
    assert shade[12, 22] > shade[28, 38] + 60


def test_a_single_pixel_and_an_empty_raster(tmp_path: Path) -> None:
    for values in (np.float32([[7]]), np.full((3, 4), -9999, np.float32)):
        results.write_raster(tmp_path / "dtm.tif", values)
        found = draw({"dtm": tmp_path / "dtm.tif"}, results.run())
        assert found is not None
        assert [p.size for p in found.pictures] == [values.shape[::-1]] * 2
    assert draw({}, results.run()) is None


def test_pictures_shrink_until_they_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noise = np.random.default_rng(1).normal(100, 20, (600, 900)).astype(np.float32)
    results.write_raster(tmp_path / "dtm.tif", noise)
    monkeypatch.setattr(pictures, "MAX_BYTES", 100_000)
    found = draw({"dtm": tmp_path / "dtm.tif"}, results.run())
    assert found is not None
    assert 50_000 < sum(len(p.uri) for p in found.pictures) * 3 / 4 <= 100_000
    wide, high = found.pictures[0].size
    assert wide / high == pytest.approx(1.5, abs=0.02)


def test_strips_do_not_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = drawn(tmp_path)
    monkeypatch.setattr(pictures, "STRIP_ROWS", 7)
    assert drawn(tmp_path) == whole


@pytest.mark.parametrize("side", [400, 1600])
def test_memory_is_that_of_one_picture(
    side: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pictures, "LONGER_SIDE", 300)
    monkeypatch.setattr(pictures, "STRIP_ROWS", 32)
    out = results.write(tmp_path / "out", results.run(outputs=ALL), side, side)
    rasters = {name.removesuffix(".tif"): out / name for name in ALL}
    draw(rasters, results.run())  # what is imported and kept on the way is not of this raster
    tracemalloc.start()
    draw(rasters, results.run())
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 30 * 300 * 300


def test_a_large_raster_is_read_from_its_overviews(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pictures, "LONGER_SIDE", 100)
    assert drawn(tmp_path, 200, 300)["dtm"].size == (100, 67)


def test_ramps() -> None:
    assert ramp_colour(VIRIDIS, 0.0) == VIRIDIS[0]
    assert ramp_colour(VIRIDIS, 1.0) == VIRIDIS[-1]
    assert ramp_colour(((0, 0, 0), (100, 200, 50)), 0.5) == (50, 100, 25)
