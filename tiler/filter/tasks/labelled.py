"""Results of the finished filter for later stages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ptd.matched.survey import SurveyPass
from tiler.config import RunConfig
from tiler.core.lattice import Cell

MATCHED = "dim"
"""Kind of photogrammetric clouds."""


@dataclass(frozen=True)
class Labelled:
    """Labels of a run, and results of the passes on its clouds.

    Attributes
    ----------
    digests : mapping of Cell to str
        Digest of each bucket's contents and of the labels of its points.
    statistics : mapping of str to dict
        State after each finished pass, by the name of the pass; empty for the method ``keep``.
    kind : str or None
        Source of the clouds as the user set it or the run found it; None if it is not known.
    noise_m : float
        Standard deviation of the heights in metres, as the user set it or the run measured it; 0 if it is not known.
    """

    digests: Mapping[Cell, str]
    statistics: Mapping[str, Mapping[str, Any]]
    kind: str | None
    noise_m: float

    @classmethod
    def of(
        cls,
        config: RunConfig,
        digests: Mapping[Cell, str],
        statistics: Mapping[str, Mapping[str, Any]],
    ) -> Labelled:
        """Make the result from the states of the passes. The noise set by the user overrides the measured noise."""
        survey = statistics.get(SurveyPass.name, {}).get("survey", {})
        noise = config.sigma or survey.get("sigma_m") or 0.0
        return cls(digests, statistics, survey.get("kind", config.source_kind), float(noise))

    @property
    def matched(self) -> bool:
        """Whether image matching made the clouds."""
        return self.kind == MATCHED
