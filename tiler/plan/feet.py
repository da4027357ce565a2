"""Settings of a run on clouds in feet: international or US survey feet, and lengths without a unit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from fractions import Fraction

from tiler.config import RunConfig
from tiler.core.units import (
    FOOT,
    METRE,
    US_SURVEY_FOOT,
    BareLength,
    FeetLength,
    Units,
    number_text,
    short_unit,
)

VERTICAL_SETTINGS = ("contour_interval", "sigma", "spike")
"""Settings that are vertical lengths."""


def with_survey_feet(config: RunConfig, units: Units) -> RunConfig:
    """Return the settings, with lengths in ``ft`` read as US survey feet if the CRS uses this foot.

    The US survey foot is 2 millionths longer than the international foot. With pixels of 3
    international feet, a sheet of 1500 units of the CRS would not be a whole number of pixels.
    """
    lengths = {}
    for name, value, unit in _lengths(config, units):
        if isinstance(value, FeetLength) and unit == US_SURVEY_FOOT:
            lengths[name] = value / FOOT * US_SURVEY_FOOT
    return config.updated(**lengths) if lengths else config


def bare_lengths(config: RunConfig, units: Units) -> list[str]:
    """Return a line for each length given without a unit if the CRS is not in metres."""
    texts = []
    for name, value, unit in _lengths(config, units):
        if isinstance(value, BareLength) and unit != METRE and value:
            option = f"--{name.replace('_', '-')}"
            number = f"{float(value):g}"
            in_unit = f"{number_text(float(value / unit))} {short_unit(unit)}"
            remedy = f"; give {number}ft for feet" if unit in (FOOT, US_SURVEY_FOOT) else ""
            texts.append(f"{option} {number} is {number} m = {in_unit}{remedy}")
    return texts


def _lengths(config: RunConfig, units: Units) -> Iterator[tuple[str, Fraction, Fraction]]:
    """Yield the name, the value and the unit in the CRS of each setting that is a length."""
    for spec in fields(config):
        value = getattr(config, spec.name)
        if spec.metadata["kind"] == "length" and value is not None:
            yield (
                spec.name,
                value,
                units.vertical if spec.name in VERTICAL_SETTINGS else units.horizontal,
            )
