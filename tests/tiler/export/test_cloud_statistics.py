"""Statistics of the records of a cloud: exact sums of any integers of 32 bits, however many come at once."""

from __future__ import annotations

import numpy as np
import pytest

from tiler.io.las.field_sums import sums_of


@pytest.mark.parametrize("high", [7, 4_194_303, 2**31 - 1])
@pytest.mark.parametrize("low", [0, -(2**31)])
def test_sums_are_exact_for_as_many_records_as_threads_compress_at_once(
    low: int, high: int
) -> None:
    n = 1 << 20
    values = np.full(n, high, np.int32)
    values[0] = low
    expected = [low, high, low + (n - 1) * high, low**2 + (n - 1) * high**2]
    assert sums_of(values) == expected
