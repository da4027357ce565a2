"""Drawings are well-formed and hold every point."""

from __future__ import annotations

import base64
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.scenes.checkpoints import checkpoints, scattered
from tests.tiler.apps.check.rasters import tilted, write_surface
from tiler.apps.check import check_dtm, write_figures
from tiler.apps.check.figures import ticks

SVG = "{http://www.w3.org/2000/svg}"


def test_histogram_and_map(tmp_path: Path) -> None:
    x, y = scattered(20)
    x[0] = -50  # outside
    offset = np.linspace(-0.1, 0.3, 20)
    path = write_surface(tmp_path / "d.tif", tilted)
    accuracy = check_dtm(path, checkpoints(x, y, tilted(x, y) - offset))
    bars, points = (
        ElementTree.parse(f).getroot() for f in write_figures(tmp_path / "f", path, accuracy)
    )
    assert (
        sum(
            int(r[0].text.rsplit(": ")[1])
            for r in bars.iter(f"{SVG}rect")
            if r.get("class") == "bar"
        )
        == 19
    )
    circles = list(points.iter(f"{SVG}circle"))
    assert len(circles) == 20
    assert circles[0].get("fill") == "#777"
    column, row = float(circles[7].get("cx", "")), float(circles[7].get("cy", ""))
    assert (column, row) == pytest.approx((x[7], 40 - y[7]), abs=0.06)
    assert f"{offset[7]:+.3f} metre" in circles[7][0].text
    image = next(points.iter(f"{SVG}image")).get("href", "")
    assert base64.b64decode(image.split(",")[1])[:4] == b"\x89PNG"
    assert not list((tmp_path / "f").glob("*.partial"))


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0, 1, [0, 0.2, 0.4, 0.6, 0.8, 1.0]),
        (-0.03, 0.07, [-0.02, 0, 0.02, 0.04, 0.06]),
        (2, 2, [2]),
    ],
)
def test_ticks_are_round(low: float, high: float, expected: list[float]) -> None:
    assert ticks(low, high) == pytest.approx(expected)
