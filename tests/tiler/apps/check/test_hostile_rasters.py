"""Damaged rasters give a figure or one line that names the raster, never another exception."""

from __future__ import annotations

import random
import warnings
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tests.tiler.apps.check.rasters import tilted, write_surface
from tiler.apps.check import Checkpoints, PointOptions, check_dtm
from tiler.apps.check.consistency import seams_of
from tiler.apps.evaluate import evaluate_dtm
from tiler.apps.info import describe_raster
from tiler.errors import ConfigError, InputError

POINTS = Checkpoints(
    np.array([[5.0, 20.0], [5.0, 20.0]]),
    np.array([100.0, 101.0]),
    ("NVA",) * 2,
    ("",) * 2,
    ("a", "b"),
)

USES: dict[str, Callable[[Path, Path], object]] = {
    "info": lambda bad, good: describe_raster(bad),
    "check": lambda bad, good: check_dtm(bad, POINTS, PointOptions()),
    "seams": lambda bad, good: seams_of(bad, Fraction(10)),
    "evaluate": lambda bad, good: evaluate_dtm(bad, good),
    "truth": lambda bad, good: evaluate_dtm(good, bad),
}


@pytest.mark.parametrize("use", USES)
def test_invalid_text(use: str, tmp_path: Path) -> None:
    good, bad = write_surface(tmp_path / "good.tif", tilted), tmp_path / "bad.tif"
    whole = good.read_bytes()
    assert whole.count(b"metre</Item>")
    bad.write_bytes(whole.replace(b"metre</Item>", b"\xffetre</Item>"))
    with pytest.raises(InputError, match=r"bad\.tif: .* can't decode byte 0xff"):
        USES[use](bad, good)


@pytest.mark.parametrize("use", USES)
def test_flipped_bytes(use: str, tmp_path: Path) -> None:
    good, bad, chance = (
        write_surface(tmp_path / "good.tif", tilted),
        tmp_path / "bad.tif",
        random.Random(4),
    )
    whole = good.read_bytes()
    for _ in range(25):
        data = bytearray(whole)
        for _ in range(chance.randint(1, 3)):
            data[chance.randrange(600)] = chance.choice((0, 1, 127, 255))
        bad.write_bytes(data)
        with warnings.catch_warnings():
            # GDAL warns of rasters without georeference and of damage
            warnings.simplefilter("ignore")
            try:
                USES[use](bad, good)
            except (InputError, ConfigError) as error:
                said = str(error)
                assert "\n" not in said
