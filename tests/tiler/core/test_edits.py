from fractions import Fraction

import numpy as np

from tiler.core.area import Area
from tiler.core.edits import FLAT, NOT_GROUND, TO_GROUND, VOID, Edit, Edits
from tiler.core.lattice import Bounds, Lattice
from tiler.core.points import PointBlock
from tiler.core.raster import NODATA, Block, RasterSpec

CELL = Lattice(Fraction(10))
ORIGIN = (100, 0)
#          x    y   z  input now  flags
POINTS = [
    (101, 1, 50, 2, 2, 0),
    (102, 2, 40, 1, 2 | 0x80, 0),
    (103, 3, 30, 2, 1, 0),
    (104, 4, 20, 1, 7, 0),  # low noise now
    (105, 5, 10, 9, 9, 0),  # water
    (106, 6, 5, 2, 1, 1),  # withheld
    (119, 9, 35, 1, 1, 0),
    (115, 5, 36, 1, 1, 0),
    (125, 5, 30, 2, 2, 0),
]


def points():
    x, y, z, given, now, flags = np.array(POINTS).T
    xyz = np.stack((x - ORIGIN[0], y, z)).astype(np.int32)
    return PointBlock(xyz, given.astype(np.uint8), flags.astype(np.uint8)), now.astype(np.uint8)


def edit(action, x0, x1, number=1, **more):
    return Edit(number, action, Area.rectangle(Bounds(x0, 0, x1, 10)), **more)


def labels(*edits):
    block, now = points()
    return Edits(edits, CELL).labels(block, now, ORIGIN).tolist()


def test_not_ground_changes_only_ground():
    assert labels(edit(NOT_GROUND, 100, 120)) == [1, 1, 1, 7, 9, 1, 1, 1, 2]


def test_ground_takes_the_ground_of_the_input():
    assert labels(edit(TO_GROUND, 100, 120)) == [2, 2 | 0x80, 2, 7, 9, 1, 1, 1, 2]


def test_ground_takes_the_lowest_point_of_each_cell_that_is_no_noise_or_water():
    assert labels(edit(TO_GROUND, 100, 120, lowest=True)) == [2, 2 | 0x80, 2, 7, 9, 1, 2, 1, 2]


def test_the_last_edit_holds():
    assert labels(edit(NOT_GROUND, 100, 120), edit(TO_GROUND, 103, 104, 2)) == [
        1,
        1,
        2,
        7,
        9,
        1,
        1,
        1,
        2,
    ]


def test_heights_of_pixels_whose_centres_are_inside():
    spec = RasterSpec(CELL, 10, 2, 2, 3)  # x 100 to 130, y 0 to 20
    heights = np.full((2, 3), 0.5, np.float32)
    heights[1, 2] = 2
    flat, void = edit(FLAT, 100, 130, 1, z=2000), edit(VOID, 112, 116, 2)
    edits = Edits((flat, void), CELL)
    changed = edits.set_heights(spec, Block(0, 0, 2, 3), heights)
    assert changed == [(flat.key, 2), (void.key, 1)]
    assert heights.tolist() == [[0.5, 0.5, 0.5], [2, NODATA, 2]]


def test_the_key_of_an_edit_does_not_depend_on_its_number_in_the_file():
    assert edit(VOID, 112, 116, 2).key == edit(VOID, 112, 116, 7).key
    others = edit(VOID, 112, 117), edit(NOT_GROUND, 112, 116), edit(FLAT, 112, 116, z=1)
    assert len({other.key for other in (*others, edit(VOID, 112, 116))}) == 4


def test_a_digest_for_bounds_holds_only_the_edits_that_touch_them():
    first, second = edit(NOT_GROUND, 100, 110), edit(VOID, 120, 130, 2)
    both, bounds = Edits((first, second), CELL), Bounds(100, 0, 112, 10)
    assert (
        both.digest(bounds, (NOT_GROUND, VOID))
        == Edits((first,), CELL).digest(bounds, (NOT_GROUND, VOID))
        != []
    )
    assert both.digest(bounds, (VOID,)) == []
    moved = Edits((edit(NOT_GROUND, 100, 109),), CELL)
    assert moved.digest(bounds, (NOT_GROUND,)) != both.digest(bounds, (NOT_GROUND,))


def test_round_trip():
    edits = Edits(
        (edit(FLAT, 100, 130, 3, z=-5), edit(TO_GROUND, 100, 110, 4, lowest=True)), CELL
    )
    assert Edits.from_json(edits.to_json()).key == edits.key
