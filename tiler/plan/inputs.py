"""Inputs of a run as its plan knows them: files, their points, the area, and features drawn by the user."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from ptd.matched.evidence import Evidence
from tiler.core.area import Area
from tiler.core.breaklines import Counts
from tiler.core.edits import Edit
from tiler.core.lattice import Bounds
from tiler.core.water import Water
from tiler.inputs import SourceInfo
from tiler.plan.density_map import DensityMap


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """Inputs that a run reads.

    Attributes
    ----------
    sources : tuple of SourceInfo
        Files that can be read and lie near the area, sorted by path.
    left_out : tuple of (str, str)
        Path and reason of each file that is left out.
    area : Area or None
        Area for which products and labels are made; None for the whole survey.
    points : int
        Number of points that are read.
    covered_m2 : float
        Area in m2 that the points cover. Overlaps of files count once.
    extent : Bounds
        Extent of the points within the area, in absolute counts.
    density_map : DensityMap
        Map that finds the densest place.
    cloud_names : dict of Path to Path
        Path of the classified file of each source, relative to OUT/classified.
    evidence : Evidence
        Evidence on the source of the clouds, found in the fields of their points.
    edits : tuple of Edit
        Edits, in the order of their file.
    lines : tuple of int64 (n, 3)
        Vertices of breaklines, in absolute counts.
    waters : tuple of Water
        Bodies of water in the file given by ``--water``, with heights if it has them.
    """

    sources: tuple[SourceInfo, ...]
    left_out: tuple[tuple[str, str], ...]
    area: Area | None
    points: int
    covered_m2: float
    extent: Bounds
    density_map: DensityMap
    cloud_names: Mapping[Path, Path]
    evidence: Evidence
    edits: tuple[Edit, ...] = ()
    lines: tuple[Counts, ...] = ()
    waters: tuple[Water, ...] = ()

    @property
    def filled(self) -> list[SourceInfo]:
        """Sources with points."""
        return filled_sources(self.sources)

    @property
    def area_key(self) -> str | None:
        """Name of the area in the store, or None if the run has no area."""
        return None if self.area is None else self.area.key

    @property
    def density(self) -> float:
        """Points per square metre of the area that they cover. Overlaps count once."""
        return self.points / self.covered_m2 if self.covered_m2 else 0.0

    def max_points(self, side_m: float) -> float:
        """Estimate the number of points in the densest square with a side in metres."""
        densest = max(self.density * side_m**2, self.density_map.max_points(side_m))
        return min(densest, self.points)


def filled_sources(sources: Iterable[SourceInfo]) -> list[SourceInfo]:
    """Return the sources with points."""
    return [s for s in sources if s.points and s.bounds is not None]
