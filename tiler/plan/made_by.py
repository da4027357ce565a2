"""Source of the clouds of a run, decided by evidence in the fields of their points."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence

from ptd.matched.evidence import DIM, LIDAR, Evidence, Finding, decided_by
from tiler.config import RunConfig
from tiler.errors import ConfigError
from tiler.inputs import SourceInfo

MIN_SHARE = 0.01
"""Smallest share of the area that clouds of one writer must cover for their kind to count."""
NAMES = {LIDAR: "a LiDAR cloud", DIM: "a photogrammetric cloud"}


def evidence_of(sources: Sequence[SourceInfo]) -> Evidence:
    """Merge the evidence of all files, weighted by area.

    The result does not depend on how a survey is cut into files.
    """
    return Evidence.merged((source.evidence, _area(source)) for source in sources)


def validate_single_kind(sources: Sequence[SourceInfo], config: RunConfig) -> None:
    """Raise ConfigError if a run without `--kind` mixes LiDAR and photogrammetric clouds.

    Files of one writer are judged together, because a small piece of a survey may lack the
    evidence.
    """
    if config.source_kind is not None:
        return
    writers: dict[tuple[object, ...], list[SourceInfo]] = defaultdict(list)
    for source in sources:
        writers[
            source.version, source.point_format, source.record_length, source.scales
        ].append(source)
    whole = sum(map(_area, sources))
    findings: dict[str, tuple[Finding, SourceInfo]] = {}
    for files in writers.values():
        finding = decided_by(evidence_of(files))
        if finding is not None and sum(map(_area, files)) >= MIN_SHARE * whole:
            findings.setdefault(finding.kind, (finding, files[0]))
    if len(findings) < 2:
        return
    raise ConfigError(
        f"{_in_words(findings.values())}: a run needs clouds of one kind; run them separately, or use --kind als or dim"
    )


def _in_words(findings: Iterable[tuple[Finding, SourceInfo]]) -> str:
    texts = []
    for finding, source in findings:
        certainty = f"{100 * (finding.sure or 0):.0f} % sure"
        texts.append(f"{source.path} is {NAMES[finding.kind]} ({certainty}: {finding.why})")
    return " and ".join(texts)


def _area(source: SourceInfo) -> float:
    """Return the area of a source's patches in square units of the CRS, or 1 if it is empty."""
    return sum((p.x1 - p.x0) * (p.y1 - p.y0) for p in source.patches) or 1.0
