"""Warnings with remedies about settings that do not suit the data."""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from ptd.matched.evidence import DIM, Finding
from ptd.matched.survey import in_words
from tiler.config import RunConfig
from tiler.core.units import METRE, length_text, short_unit, written_unit

Float64 = npt.NDArray[np.float64]

FOR_SCANNERS = ("classic", "chen2023", "ridge2016")
"""Methods whose defaults are made for laser scanning."""


def preflight_warnings(
    config: RunConfig,
    finding: Finding | None,
    density: float,
    halo_m: float | None,
    unit: Fraction = METRE,
) -> Iterator[str]:
    """Yield the warnings that follow from the headers and a sample of the points.

    Parameters
    ----------
    config : RunConfig
    finding : Finding or None
        Source of the clouds; None if the fields of their points do not decide it.
    density : float
        Points per m2.
    halo_m : float or None
        Halo of the method that usually suffices; None if every pass has a fixed radius.
    unit : Fraction
        Metres per horizontal unit of the CRS.
    """
    given = config.source_kind
    if finding is not None and given not in (None, finding.kind) and config.statistics is None:
        yield overridden_kind(config, in_words(finding))
    elif config.method in FOR_SCANNERS and finding is not None and finding.kind == DIM:
        yield (
            f"the points look like image matching ({finding.why}), but method {config.method} is made for LiDAR; "
            "use --preset dim"
        )
    spacing = 1 / math.sqrt(density)
    if config.resolution is not None and float(config.resolution) < 0.7 * spacing:
        coarser = f"{math.ceil(spacing / float(unit) * 10) / 10:g}"
        if unit != METRE:
            coarser += written_unit(unit)
        yield (
            f"--resolution {length_text(config.resolution, unit)} is finer than the point spacing of "
            f"{spacing / float(unit):.2g} {short_unit(unit)}, so most pixels will be interpolated; use --resolution "
            f"{coarser}"
        )
    if config.halo is not None and halo_m is not None and float(config.halo) < halo_m / 2:
        yield (
            f"--halo {length_text(config.halo, unit)} is too small for method {config.method}, so most tiles will be "
            f"repeated with a wider halo; leave it out, or use --halo {halo_m:g}"
        )


def overridden_kind(config: RunConfig, looks_like: str) -> str:
    """Return the warning that the user gives another kind than the points show."""
    other = "als" if config.kind == "dim" else "dim"
    return (
        f"the points look like {looks_like}; {config.kind_option} overrides that, which loses ground if it is wrong: "
        f"use --kind {other} then"
    )
