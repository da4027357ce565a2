"""Cards show the terrain of a place: one scale of greys for both hillshades, and heights near the terrain."""

from __future__ import annotations

import base64
import re
from typing import Any

import numpy as np
import pytest
import rasterio

from tests.tiler.report import results
from tests.tiler.report.results import Reader
from tiler.report.cards import Card, Section, views
from tiler.report.document import page

ROOT = np.empty((2, 0))


def card(ground: Any = ROOT, others: Any = ROOT, terrain: float = 100.0) -> Card:
    """A slope of 1 in 4, with a pit of steep walls that the edit fills."""
    before = np.tile(np.arange(40, dtype=np.float32) / 4, (40, 1))
    before[:, 30:] = 7.5
    after = before.copy()
    before[10:20, 5:15] -= 30
    at = np.arange(40) + 0.5
    line = np.full(40, terrain)
    return Card(
        columns={"action": "not ground"},
        middle=(20.0, 20.0),
        outline=(),
        ends=np.array([(0.0, 20.0), (40.0, 20.0)]),
        geometry=None,
        extent=(0.0, 0.0, 40.0, 40.0),
        before=before,
        after=after,
        section=Section(40.0, at, line, None, np.zeros(40, bool), ground, others, 1.0),
    )


def markup(place: Card, units: tuple[float, float] = (1.0, 1.0)) -> str:
    header = views(place, results.run(), units)
    return page("title", header, []).decode()


def greys(uri: str) -> np.ndarray:
    """Greys of a paletted picture."""
    with rasterio.MemoryFile(base64.b64decode(uri)) as file, file.open() as picture:
        colours = picture.colormap(1)
        return np.vectorize(lambda value: colours[value][0])(picture.read(1))


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_both_hillshades_of_a_card_have_one_scale() -> None:
    before, after = map(greys, re.findall(r"data:image/png;base64,([^\"]+)", markup(card())))
    beyond = np.ones((40, 40), bool)
    beyond[8:22, 3:17] = False
    assert np.array_equal(before[beyond], after[beyond])
    assert not np.array_equal(before, after)


@pytest.mark.parametrize("metres_high", [1.0, 0.3048])
def test_a_section_shows_the_terrain_and_not_the_tops_of_trees(metres_high: float) -> None:
    """Half of the points are those of tall trees, and every fourth is a low error."""
    heights = np.tile([100.0, 160.0, 160.0, 40.0], 100)
    others = np.stack((np.linspace(0, 40, heights.size), heights))
    text = markup(card(others=others), (1.0, metres_high))
    beyond = 10 / metres_high
    labels = [float(z) for z in re.findall(r'text-anchor="end"[^>]*>([0-9.]+)<', text)]
    assert labels
    assert 100 - 1.2 * beyond <= min(labels) < max(labels) <= 100 + 1.2 * beyond
    reader = Reader()
    reader.feed(text)
    reader.close()
    unit = "m" if metres_high == 1 else "ft"
    told = dict(re.findall(r"Points (above|below) ([0-9.]+) " + unit, reader.texts[""]))
    assert {*told} == {"above", "below"}
    assert float(told["above"]) - 100 == pytest.approx(1.1 * beyond, abs=0.1)
    assert 100 - float(told["below"]) == pytest.approx(1.1 * beyond, abs=0.1)
    assert text.count("h0") == 100


def test_points_that_are_all_shown_need_no_words() -> None:
    ground = np.stack((np.linspace(0, 40, 50), np.linspace(99.8, 100.2, 50)))
    assert "are not shown" not in markup(card(ground))


def test_a_section_where_nothing_is_known_has_no_heights() -> None:
    text = markup(card(terrain=np.nan))
    assert "Nothing is known along the dashed line." in text
    assert 'text-anchor="end"' not in text
    assert 'text-anchor="end"' in markup(card(ROOT, np.array([[1.0], [100.0]]), np.nan))
