"""The weights of evidence are those that the script fits, and they have 96 % of real clouds right."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ptd.matched import evidence
from tests.benchmarks.kind_weights import fitted, left_out, read, right


def test_weights_in_use_are_those_that_fit(shared_data: Path) -> None:
    clouds = read(shared_data / "fingerprints" / "fingerprints.csv")
    assert right(clouds, left_out(clouds)) >= 0.96 * len(clouds)
    *most, no_colour = fitted(clouds)
    used = [
        evidence.TRACE, evidence.NO_TRACE, evidence.OWN_INTENSITY, evidence.NO_INTENSITY, evidence.GREY_INTENSITY,
        evidence.COLOUR,
    ]  # fmt: skip
    assert np.allclose(most, used, atol=0.06)
    assert no_colour < evidence.NO_COLOUR < 0
