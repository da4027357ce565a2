"""The classes of the filters and of the clouds that a run writes."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ptd.ground import labelling
from tiler.core import points
from tiler.core.lattice import CoordFrame, Lattice
from tiler.core.points import (
    REPEATED_FLAG,
    WATER_BIT,
    WITHHELD_FLAG,
    PointBlock,
    pack_origin,
    participates,
    representatives,
    written_classes,
)
from tiler.core.selection import ALL, ONLY_GROUND
from tiler.ingest.assemble import bucket_order

NO_PART, NEITHER, GROUND, LOW, BRIDGE = 0, 1, 2, 7, 17
PLAIN = (0, 1, 2)
OTHERS = (3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 17, 18, 19, 31, 32, 64, 255)


def test_both_name_the_same_classes() -> None:
    """ptd must not import tiler, so the classes are defined twice."""
    for name in ("UNCLASSIFIED", "GROUND", "LOW_NOISE"):
        assert getattr(labelling, name) == getattr(points, name)


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


FRAME = CoordFrame(origin=(-50, 5))
POINTS = st.lists(
    st.tuples(
        st.integers(-24, -13),
        st.integers(12, 23),
        st.integers(0, 1),
        st.sampled_from([0, 1, 2, 5, 7, 9]),
        st.sampled_from([0, WITHHELD_FLAG]),
        st.integers(1, 2),
    ),
    min_size=1,
    max_size=60,
)


def stored(points: Any, fine: Lattice, sources: Any) -> tuple[PointBlock, int]:
    """The points of a bucket as ingest stores them, and the number of candidates."""
    x, y, z, classes, flags, returns = np.array(points).T
    block = PointBlock(
        np.stack((x - FRAME.origin[0], y - FRAME.origin[1], z)).astype(np.int32),
        classes.astype(np.uint8),
        flags.astype(np.uint8),
        np.stack((returns, returns)).astype(np.uint8),
        origin=pack_origin(0, np.arange(len(x))) + (np.asarray(sources, np.int64) << 40),
    )
    taking = participates(block.classification, block.flags)
    found = bucket_order(block, taking, FRAME, fine)
    flags = block.flags | (found.repeated * np.uint8(REPEATED_FLAG))
    ordered = PointBlock(
        block.xyz, block.classification, flags, block.returns, origin=block.origin
    )
    return ordered.take(found.order), found.n_candidates


@given(points=POINTS, fine=st.sampled_from([Fraction(1), Fraction(3), Fraction(12, 7)]))
def test_each_repeated_point_leads_to_the_one_that_a_run_sees(
    points: Any, fine: Fraction
) -> None:
    block, n_candidates = stored(points, Lattice(fine), 0)
    repeated, chosen = representatives(block, n_candidates, Lattice(fine), FRAME)
    np.testing.assert_array_equal(block.xyz[:, repeated], block.xyz[:, chosen])
    seen = (block.flags & REPEATED_FLAG) == 0
    assert seen[chosen].all()
    assert not seen[repeated].any()
    assert int(seen.sum()) == len({p[:3] for p in points})
    taking = participates(block.classification, block.flags & ~np.uint8(REPEATED_FLAG))
    assert taking[chosen][taking[repeated]].all()
    assert taking[:n_candidates].all()
    assert seen[:n_candidates].all()


@given(points=POINTS, seed=st.integers(0, 100))
def test_files_do_not_decide_which_point_a_run_sees(points: Any, seed: int) -> None:
    """The same points in another order, of other files, and some of them once more."""
    random, fine = np.random.default_rng(seed), Lattice(Fraction(3))
    more = [*points, *(points[i] for i in random.integers(0, len(points), 9))]
    shuffled = [more[i] for i in random.permutation(len(more))]
    blocks = []
    for each in (points, shuffled):
        block, _ = stored(each, fine, random.integers(0, 3, len(each)))
        seen = block.take((block.flags & REPEATED_FLAG) == 0)
        blocks.append((seen.xyz, seen.classification, seen.flags, seen.returns))
    for one, other in zip(*blocks, strict=True):
        np.testing.assert_array_equal(one, other)
