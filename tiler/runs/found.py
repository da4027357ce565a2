"""What a stage of a run found, for the stages after it. The data themselves are in the store."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from typing import Any

from ptd.matched.survey import SurveyPass
from tiler.config import RunConfig
from tiler.core.drawn_sheets import DrawnSheet
from tiler.core.edits import DrawnDeck
from tiler.core.lattice import Bounds, Cell
from tiler.core.points import (
    OVERLAP_FLAG,
    REPEATED_FLAG,
    STRAY_FLAG,
    SYNTHETIC_FLAG,
    UNSELECTED_FLAG,
    WITHHELD_FLAG,
)
from tiler.core.products import MODELS
from tiler.core.raster import RasterSpec
from tiler.core.records import BlockRecord, BucketRecord, SpoolRecord, buckets_in
from tiler.core.water import Waters
from tiler.inputs import SourceInfo
from tiler.plan import Plan
from tiler.store import Commits

MATCHED = "dim"
"""Kind of photogrammetric clouds."""


@dataclass(frozen=True)
class Source:
    """Readable file, its number in the store, and the digest of its bytes."""

    info: SourceInfo
    number: int
    content: str

    @property
    def name(self) -> str:
        """Beginning of the keys of its pieces, such as ``s000012``."""
        return f"s{self.number:06d}"

    @property
    def identity(self) -> list[Any]:
        """Properties of the file on which its pieces depend."""
        return [self.info.size, self.info.digest, self.content, self.info.salvaged]


def by_source(spooled: Commits) -> dict[str, list[SpoolRecord]]:
    """Return the records of the pieces of each source by its name."""
    records: dict[str, list[SpoolRecord]] = defaultdict(list)
    for key, (_, stored) in spooled.items():
        records[source_of(key)].append(SpoolRecord.of(stored))
    return records


def source_of(piece: str) -> str:
    """Return the name of the source of a piece."""
    return piece.partition("-")[0]


def surveys_of_sources(plan: Plan, sources: Iterable[Source]) -> dict[int, int]:
    """Return the place of each source's survey in `Inputs.surveys`, by the number of the source."""
    places = {
        path: place for place, survey in enumerate(plan.inputs.surveys) for path in survey.paths
    }
    return {source.number: places[source.info.path] for source in sources if places}


def skip_flags(plan: Plan) -> int:
    """Return the bits of flags that exclude a point from filtering."""
    synthetic = SYNTHETIC_FLAG if plan.config.skip_synthetic else 0
    overlap = OVERLAP_FLAG if plan.config.skip_overlap else 0
    return WITHHELD_FLAG | STRAY_FLAG | UNSELECTED_FLAG | REPEATED_FLAG | synthetic | overlap


@dataclass(frozen=True)
class IngestResult:
    """Result of the ingest: record of each bucket, and digest of the task that assembled the bucket."""

    records: dict[Cell, BucketRecord]
    digests: dict[Cell, str]

    @classmethod
    def of(cls, commits: Commits) -> IngestResult:
        """Make the result from the commits of the assembly tasks."""
        records: dict[Cell, BucketRecord] = {}
        digests: dict[Cell, str] = {}
        for digest, record in commits.values():
            for bucket in buckets_in(record):
                cell = Cell(*bucket.cell)
                records[cell], digests[cell] = bucket, digest
        return cls(dict(sorted(records.items())), digests)

    @cached_property
    def bounds(self) -> Bounds:
        """Bounds of all stored points except strays, in absolute counts."""
        known = (
            Bounds.from_json(record.bounds) for record in self.records.values() if record.bounds
        )
        return reduce(Bounds.union, known)


@dataclass(frozen=True)
class CanopyCells:
    """Robust cells of a photogrammetric cloud. The label of a cell says whether it lies under a canopy.

    Attributes
    ----------
    elected : str
        Name of the cells in the store, as elected points.
    labels : str
        Name of the labels of the cells in the store.
    digests : mapping of Cell to str
        Digest of the cells and labels of each bucket.
    blocks : mapping of (int, int) to int
        Area in square metres that the canopy covers in each block (`ptd.matched.passes.BLOCK_M`), by column and row.
    """

    elected: str
    labels: str
    digests: Mapping[Cell, str]
    blocks: Mapping[tuple[int, int], int]


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
    canopy : CanopyCells or None
        Cells in which the filter found a closed canopy, if there is any.
    """

    digests: Mapping[Cell, str]
    statistics: Mapping[str, Mapping[str, Any]]
    kind: str | None
    noise_m: float
    canopy: CanopyCells | None = None

    @classmethod
    def of(
        cls,
        config: RunConfig,
        digests: Mapping[Cell, str],
        statistics: Mapping[str, Mapping[str, Any]],
        canopy: CanopyCells | None = None,
    ) -> Labelled:
        """Make the result from the states of the passes. The noise set by the user overrides the measured noise."""
        survey = statistics.get(SurveyPass.name, {}).get("survey", {})
        noise = config.sigma or survey.get("sigma_m") or 0.0
        kind = survey.get("kind", config.source_kind)
        return cls(digests, statistics, kind, float(noise), canopy)

    @property
    def matched(self) -> bool:
        """Whether image matching made the clouds."""
        return self.kind == MATCHED


@dataclass(frozen=True)
class Sheet:
    """Part of the products that has files of its own.

    Attributes
    ----------
    spec : RasterSpec
        Pixels of the files.
    cells : list of Cell
        Buckets with points of the sheet.
    drawn : DrawnSheet or None
        Sheet that the user drew, or None for a rectangle.
    """

    spec: RasterSpec
    cells: list[Cell]
    drawn: DrawnSheet | None = None


@dataclass(frozen=True)
class Gridded:
    """Rasters of a run in the store, and what the files made from them need.

    Attributes
    ----------
    plan : Plan
        Plan of the run, with the settings that its stages decided.
    assembled : IngestResult
    spec, coarse : RasterSpec
        Pixels of the products, and coarse cells.
    made : mapping of str to Commits
        Commits of the blocks of each raster.
    fills : mapping of str to float
        Value of the pixels of each raster that no block has.
    waters : Waters
    edits : str or None
        Key in the store of the edits.
    decks : tuple of DrawnDeck
    drawn : str
        Name in the store of the areas of drawn sheets, or an empty text.
    sheets : sequence of Sheet
        Sheets, if the products are divided.
    """

    plan: Plan
    assembled: IngestResult
    spec: RasterSpec
    coarse: RasterSpec
    made: Mapping[str, Commits]
    fills: Mapping[str, float]
    waters: Waters = field(default_factory=lambda: Waters(()))
    edits: str | None = None
    decks: tuple[DrawnDeck, ...] = ()
    drawn: str = ""
    sheets: Sequence[Sheet] = ()

    def checksums(self, raster: str, blocks: Iterable[str] | None = None) -> list[list[str]]:
        """Return `checksums` of a raster."""
        return checksums(self.made[raster], blocks)


def checksums(made: Commits, blocks: Iterable[str] | None = None) -> list[list[str]]:
    """Return name and checksum of all finished blocks of a raster, or of the finished blocks among ``blocks``."""
    names = sorted(made) if blocks is None else (name for name in blocks if name in made)
    return [[name, BlockRecord.of(made[name][1]).checksum] for name in names]


def final_raster(product: str, config: RunConfig) -> str:
    """Return the name of the raster that is delivered as a product."""
    if product in outlined_models(config):
        return f"{product}-outlined"
    return filled_raster(product, config)


def outlined_models(config: RunConfig) -> tuple[str, ...]:
    """Return the models from which a raster ``<name>-outlined`` is made.

    With ``--outline survey``, all models end at the outline of the survey. Otherwise only the
    terrain needs this raster, for level water and for canopies.
    """
    return MODELS if config.outline == "survey" else ("dtm",)


def filled_raster(product: str, config: RunConfig) -> str:
    """Return the name of the raster of a product with filled voids, or of the product if no voids are filled."""
    return f"{product}-filled" if product in MODELS and config.voids != "leave" else product
