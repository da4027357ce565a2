"""Podiums and lower roofs among seeds, by hand."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from ptd.frame import Scale
from ptd.methods.dong2017.facades import on_podium

CM = 100
SCALE = Scale(Fraction(1, CM), Fraction(1, CM), (4_000_000, 8_000_000))

PODIUM = [
    # d 5 m: ground may rise by 0.3 5 + 1.65 sqrt(2) 0.1 = 1.733 m.
    ([0, 500], [0, 173], [False, False]),
    ([0, 500], [0, 174], [False, True]),
    ([0, 500], [-174, 0], [False, True]),
    ([0, 1100], [0, 900], [False, False]),  # beyond the radius of 10 m
    # A slope of 20 % keeps all its seeds; the paper's rule would keep only the lowest.
    ([0, 500, 1000, 1500], [0, 100, 200, 300], [False] * 4),
    # All seeds are judged before any is dropped: the middle one drops the highest, and is
    # dropped as well.
    ([0, 400, 800], [0, 300, 600], [False, True, True]),
]


@pytest.mark.parametrize(("x", "z", "dropped"), PODIUM)
def test_podiums_by_equation_1(x: list[int], z: list[int], dropped: list[bool]) -> None:
    columns = np.array(x, np.int32), np.zeros(len(x), np.int32), np.array(z, np.int32)
    assert on_podium(*columns, SCALE, 10.0, 0.3, 0.1).tolist() == dropped


def test_no_seeds_no_podium() -> None:
    none = np.zeros(0, np.int32)
    assert on_podium(none, none, none, SCALE, 10.0, 0.3, 0.1).size == 0
