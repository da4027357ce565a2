"""Results that the stages add to run.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from ptd.passes import State
from tiler.core.records import to_json
from tiler.core.results import (
    AboveResult,
    BreaklineCounts,
    BridgeResult,
    CanopyResult,
    ClassCounts,
    ContourResult,
    Doubt,
    EditResult,
    FetchedBytes,
    Implausible,
    LabelCounts,
    OutlineResult,
    PointCounts,
    SigmaResult,
    SpotCounts,
    Stray,
    SurfaceResult,
    SurveyDates,
    TerrainResult,
    VoidResult,
    VoidsResult,
    WaterResult,
)


class Results:
    """Results of a run. Each attribute that was set is an entry of run.json.

    An attribute is set by its stage. Defaults are not written to run.json.

    Attributes
    ----------
    products_at : str or None
        URL of OUT, if it is at a URL.
    given : list of str
        INPUT as given by the user.
    seconds : float
    report : str or None
        Name of the report. None if it could not be made.
    report_title : str or None
        Title that the user gave to the report.
    inputs : sequence of mapping
        Sources, with the digest of the bytes and the number of stored points.
    fetched : FetchedBytes or None
        None unless inputs are at URLs.
    dates : SurveyDates or None
        None if neither points nor headers have a date.
    crs_code : str or None
        Code of the horizontal CRS.
    statistics : mapping
        State after each pass of the method.
    mask : dict of str to int
        Number of pixels by value of the mask.
    sheets : int
        Number of sheets.
    water_doubts, canopy_doubts : list of Doubt
        Doubts about bodies of water (with positions) and about closed canopy (with bounds).
    doubts : list of str
        Decisions that are uncertain.
    advice : list of str
        Settings that the data show to be wrong.
    advice_at : list of [x, y]
        Position of each advice.
    outputs : mapping of str to int
        Files in OUT that this run wrote or found up to date, and their sizes in bytes.
    digests : mapping of str to str
        Digests of these files.
    made_of : mapping of str to str
        Digest of the points, labels and settings from which each product was made.
    earlier_outputs : mapping of str to str or None
        Files in OUT that earlier runs may have written, each with its digest from their `made_of`, or None if that is
        not known or outdated.
    healed : sequence of str
        Damaged objects of the store that the run repaired.
    """

    products_at: str | None
    given: list[str]
    seconds: float
    report: str | None
    report_title: str | None
    inputs: Sequence[Mapping[str, Any]]
    fetched: FetchedBytes | None = None
    dates: SurveyDates | None
    crs_code: str | None
    counts: PointCounts
    classes: ClassCounts
    strays: list[Stray]
    statistics: Mapping[str, State]
    filter: LabelCounts
    canopy: CanopyResult
    breaklines: BreaklineCounts
    bridges: list[BridgeResult]
    edits: Sequence[EditResult] = ()
    water: list[WaterResult]
    dtm: TerrainResult
    dsm: SurfaceResult
    mask: dict[str, int]
    sigma: SigmaResult
    voids: VoidsResult
    without_returns: list[VoidResult]
    above_returns: AboveResult
    implausible: list[Implausible]
    contours: ContourResult
    spots: SpotCounts
    sheets: int
    outline: OutlineResult | None = None
    water_doubts: list[Doubt]
    canopy_doubts: list[Doubt]
    doubts: list[str]
    advice: list[str]
    advice_at: list[list[float]]
    outputs: Mapping[str, int] = MappingProxyType({})
    digests: Mapping[str, str] = MappingProxyType({})
    made_of: Mapping[str, str]
    earlier_outputs: Mapping[str, str | None]
    healed: Sequence[str] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the entries of run.json."""
        return {name: to_json(value) for name, value in vars(self).items()}
