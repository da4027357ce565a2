"""What the finished filter found, as the stages after it take it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ptd.matched.survey import SurveyPass
from tiler.config import RunConfig
from tiler.core.lattice import Cell

MATCHED = "dim"
"""Kind of matched clouds: they have holes anywhere, and noise, on water as well."""


@dataclass(frozen=True)
class Labelled:
    """The labels of a run, and what the passes found about its clouds.

    Attributes
    ----------
    digests : mapping of Cell to str
        Digest of the contents of each bucket and of the labels of its points.
    statistics : mapping of str to dict
        State after each pass that was done, by the name of the pass; empty for the method ``keep``.
    kind : str or None
        What made the clouds, as the run found it or the user says; None if neither did.
    noise_m : float
        Standard deviation of the heights in metres, as the user says it or the run measured it; 0 if it is not known.
    """

    digests: Mapping[Cell, str]
    statistics: Mapping[str, Mapping[str, Any]]
    kind: str | None
    noise_m: float

    @classmethod
    def of(
        cls, config: RunConfig, digests: Mapping[Cell, str], statistics: Mapping[str, Mapping[str, Any]]
    ) -> Labelled:
        """From what the passes gave; what the user says of the noise counts before what the survey measured."""
        survey = statistics.get(SurveyPass.name, {}).get("survey", {})
        noise = config.sigma or survey.get("sigma_m") or 0.0
        return cls(digests, statistics, survey.get("kind", config.source_kind), float(noise))

    @property
    def matched(self) -> bool:
        """Whether image matching made the clouds."""
        return self.kind == MATCHED
