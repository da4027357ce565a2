"""Evidence in the fields of the points about what made the clouds of a run."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence

from ptd.matched.evidence import DIM, LIDAR, Evidence, Finding, decided_by
from tiler.config import RunConfig
from tiler.errors import ConfigError
from tiler.inputs import SourceInfo

NOTICEABLE = 0.01
"""A run holds both kinds if laser scans and matched clouds each cover at least this share of the area."""
NAMES = {LIDAR: "a LiDAR cloud", DIM: "a photogrammetric cloud"}


def evidence_of(sources: Sequence[SourceInfo]) -> Evidence:
    """Evidence of all files, weighted by area, so that it does not matter how a survey is cut into files."""
    return Evidence.merged((source.evidence, _area(source)) for source in sources)


def validate_single_kind(sources: Sequence[SourceInfo], config: RunConfig) -> None:
    """Raise ConfigError if some files are surely laser scans, others surely matched clouds, and `--kind` is not given.

    Files of one writer are judged together, as a small piece of a survey may lack the evidence.
    """
    if config.source_kind is not None:
        return
    writers: dict[tuple[object, ...], list[SourceInfo]] = defaultdict(list)
    for source in sources:
        writers[source.version, source.point_format, source.record_length, source.scales].append(source)
    whole = sum(map(_area, sources))
    found: dict[str, tuple[Finding, SourceInfo]] = {}
    for files in writers.values():
        made = decided_by(evidence_of(files))
        if made is not None and sum(map(_area, files)) >= NOTICEABLE * whole:
            found.setdefault(made.kind, (made, files[0]))
    if len(found) < 2:
        return
    raise ConfigError(
        f"{_told(found.values())}: a run needs clouds of one kind; run them separately, or use --kind als or dim"
    )


def _told(found: Iterable[tuple[Finding, SourceInfo]]) -> str:
    texts = []
    for made, source in found:
        texts.append(f"{source.path} is {NAMES[made.kind]} ({100 * (made.sure or 0):.0f} % sure: {made.why})")
    return " and ".join(texts)


def _area(source: SourceInfo) -> float:
    """Area that the points of a source cover, in square units of the CRS."""
    return sum((p.x1 - p.x0) * (p.y1 - p.y0) for p in source.patches) or 1.0
