"""Result of the ingest for later stages, and flags that exclude points from the filter."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, reduce

from tiler.core.lattice import Bounds, Cell
from tiler.core.points import (
    OVERLAP_FLAG,
    REPEATED_FLAG,
    STRAY_FLAG,
    SYNTHETIC_FLAG,
    UNSELECTED_FLAG,
    WITHHELD_FLAG,
)
from tiler.core.records import BucketRecord, buckets_in
from tiler.plan import Plan
from tiler.store import Commits


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
