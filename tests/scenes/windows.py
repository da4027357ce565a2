"""Windows of the clouds of `tests.ptd.scenes`: their frame, their side, and what a window sees of them."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from ptd.frame import OPEN, Scale, Window
from tests.ptd.scenes import CM, Cloud

ORIGIN = (-7_123_456, 93_000_017)
SCALE = Scale(Fraction(1, CM), Fraction(1, CM), ORIGIN)
SIDE = 16_000


def cut(cloud: Cloud, window: Window) -> np.ndarray:
    """Which points lie in a window."""
    return window.contains(cloud[0], cloud[1])


def opened(cloud: Cloud, window: Window) -> Window:
    """The sides open behind which there is no point at all."""
    x, y = cloud[0], cloud[1]
    return Window(
        window.west if (x < window.west).any() else -OPEN,
        window.south if (y < window.south).any() else -OPEN,
        window.east if (x >= window.east).any() else OPEN,
        window.north if (y >= window.north).any() else OPEN,
    )
