"""The classes of the filters and of the clouds that a run writes."""

from __future__ import annotations

import pytest

from ptd.ground import labelling
from tiler.core import classes
from tiler.core.classes import WATER_BIT, written_classes
from tiler.core.selection import ALL, ONLY_GROUND

NO_PART, NEITHER, GROUND, LOW, BRIDGE = 0, 1, 2, 7, 17
PLAIN = (0, 1, 2)
OTHERS = (3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 17, 18, 19, 31, 32, 64, 255)


def test_both_name_the_same_classes() -> None:
    """ptd must not import tiler, so the classes are defined twice."""
    for name in ("UNCLASSIFIED", "GROUND", "LOW_NOISE"):
        assert getattr(labelling, name) == getattr(classes, name)


@pytest.mark.parametrize("before", PLAIN)
def test_classes_without_an_object_get_the_class_that_was_found(before: int) -> None:
    found = written_classes(ONLY_GROUND)[:, before].tolist()
    assert [found[label] for label in (GROUND, LOW, NEITHER, BRIDGE)] == [2, 7, 1, 17]
    assert [found[label | WATER_BIT] for label in (GROUND, LOW, NEITHER, BRIDGE)] == [
        9,
        7,
        9,
        17,
    ]


@pytest.mark.parametrize("before", OTHERS)
def test_other_classes_stay_where_there_is_no_ground(before: int) -> None:
    found = written_classes(ONLY_GROUND)[:, before].tolist()
    assert [found[label] for label in (GROUND, LOW, NEITHER, BRIDGE)] == [2, 7, before, 17]
    assert [found[label | WATER_BIT] for label in (GROUND, LOW, NEITHER, BRIDGE)] == [
        9,
        7,
        before,
        17,
    ]


@pytest.mark.parametrize("before", [*PLAIN, *OTHERS])
def test_with_all_every_point_gets_the_class_of_its_label(before: int) -> None:
    found = written_classes(ALL)[:, before].tolist()
    for bit in (0, WATER_BIT):
        assert [found[label | bit] for label in (GROUND, LOW, NEITHER, BRIDGE)] == [2, 7, 1, 17]


@pytest.mark.parametrize("reclass", [ONLY_GROUND, ALL])
@pytest.mark.parametrize("before", [*PLAIN, *OTHERS])
def test_points_that_take_no_part_keep_their_class(before: int, reclass: str) -> None:
    table = written_classes(reclass)
    assert table[NO_PART, before] == table[NO_PART | WATER_BIT, before] == before
