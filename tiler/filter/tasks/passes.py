"""Tasks of filter tiles, with the digest of everything on which their results depend.

A task is up to date if the store has a commit with its digest. So a change of a parameter, an
input file or a neighbouring bucket repeats only the tasks whose results it can change.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

from ptd.frame import Scale
from ptd.methods import METHODS
from ptd.passes import Pass, later_passes, read_at_candidates
from tiler.core.classes import LABELS
from tiler.core.digests import digest_of
from tiler.core.lattice import Cell
from tiler.core.records import TileRecord
from tiler.filter.reading import FilterTile
from tiler.filter.tasks.tiles import BucketPoints, tiles_of
from tiler.filter.tile import filter_tile, influence_margin_m, local_window
from tiler.plan import Plan
from tiler.plan.memory import held_bytes
from tiler.runs.found import IngestResult, skip_flags
from tiler.schedule import Task, calling
from tiler.store import Commits


@dataclass(frozen=True)
class PassInputs:
    """Results of earlier passes that the next pass can read.

    Attributes
    ----------
    digests : mapping of Cell to str
        Digest of each bucket's contents and of the latest labels of its points.
    labels : str or None
        Name in the store of the latest labels of the points of the cloud.
    candidates_only : bool
        Whether ``labels`` has labels only of candidates.
    elected : str or None
        Name in the store of the points that the latest electing pass made (see `ptd.passes.Pass.elects`).
    elected_labels : str or None
        Name in the store of the latest labels of elected points.
    elected_digests : mapping of Cell to str
        Digest of each bucket's elected points and of their latest labels.
    n_elected : mapping of Cell to int
        Number of each bucket's elected points, 0 if its tile failed.
    """

    digests: Mapping[Cell, str]
    labels: str | None = None
    candidates_only: bool = False
    elected: str | None = None
    elected_labels: str | None = None
    elected_digests: Mapping[Cell, str] = field(default_factory=dict)
    n_elected: Mapping[Cell, int] = field(default_factory=dict)

    def after(
        self,
        number: int,
        step: Pass,
        is_last: bool,
        candidates_only: bool,
        assembled: IngestResult,
        done: Commits,
    ) -> PassInputs:
        """Return the results after a finished pass that elects points or gives labels.

        See `labels_scope` for ``is_last`` and ``candidates_only``.
        """
        if step.elects:
            counts = dict.fromkeys(assembled.records, 0)
            for tile in tile_records(done):
                cells = (Cell(*cell) for cell in tile.cells)
                counts |= dict(zip(cells, tile.elected_points or (), strict=True))
            digests = _content_digests(
                assembled, ((tile, tile.elected) for tile in tile_records(done))
            )
            if step.gives_labels:
                labels = label_digests(assembled, done)
                digests = {
                    cell: digest_of(digest, labels[cell]) for cell, digest in digests.items()
                }
            return replace(
                self,
                elected=elected_name(number),
                elected_labels=labels_name(number) if step.gives_labels else None,
                elected_digests=digests,
                n_elected=counts,
            )
        digests = label_digests(assembled, done)
        # The pass has labelled elected points, not points of the cloud.
        if step.elected and not is_last:
            both = {
                cell: digest_of(digest, self.elected_digests[cell])
                for cell, digest in digests.items()
            }
            return replace(self, elected_labels=labels_name(number), elected_digests=both)
        return replace(
            self, labels=labels_name(number), candidates_only=candidates_only, digests=digests
        )


def labels_name(number: int) -> str:
    """Return the name in the store of the labels of a pass that is not the last pass."""
    return f"{LABELS}-{number}"


def elected_name(number: int) -> str:
    """Return the name in the store of the points that a pass elects."""
    return f"elected-{number}"


def labels_scope(plan: Plan, number: int, state: Mapping[str, Any]) -> tuple[bool, bool]:
    """Return whether the labels of a pass are final, and whether the pass labels only candidates."""
    params = METHODS[plan.config.method].params(**plan.method.parameters)
    step = params.passes[number]
    if not step.gives_labels:
        return False, False
    later = later_passes(params.passes, number, state)
    labels_cloud = not (step.elected or step.elects)
    can_skip_others = labels_cloud and not step.label_margin_m and plan.on_candidates
    return not later, can_skip_others and read_at_candidates(later)


def filter_tasks(
    plan: Plan,
    assembled: IngestResult,
    number: int,
    state: Mapping[str, Any],
    inputs: PassInputs,
) -> Iterator[Task]:
    """Yield a task for each tile of the pass ``number``.

    ``state`` and ``inputs`` are the state and the results after the earlier passes.
    """
    frame = plan.frame
    params = METHODS[plan.config.method].params(**plan.method.parameters)
    step = params.passes[number]
    is_last, candidates_only = labels_scope(plan, number, state)
    if step.elected and inputs.elected is None:
        raise ValueError(
            f"pass {step.name} works on elected points, but no earlier pass elected any"
        )
    influence_margin = math.ceil(frame.counts(Fraction(influence_margin_m(step, params))))
    label_margin = math.ceil(frame.counts(Fraction(repr(float(step.label_margin_m)))))
    reads_labels = "labels" in step.columns
    records = {
        cell: BucketPoints(record.n, record.n_candidates, inputs.n_elected.get(cell, 0))
        for cell, record in assembled.records.items()
    }
    scale = Scale(frame.metres_xy, frame.metres_z, frame.origin)
    for tile in tiles_of(plan, records, plan.method.passes[number]):
        margin = max(tile.max_halo + influence_margin, label_margin)
        influence = plan.buckets.hull(tile.cells).pad(margin)
        work = FilterTile(
            method=plan.config.method,
            parameters=plan.method.parameters,
            number=number,
            state=step.local(state, local_window(influence, frame.origin), scale),
            cells=tile.cells,
            halo=tile.halo,
            max_halo=tile.max_halo,
            keep_classes=plan.config.keep_classes,
            skip_flags=skip_flags(plan),
            labels_in=inputs.labels if reads_labels else None,
            labels_out=LABELS if is_last else labels_name(number),
            elected_in=inputs.elected if step.elected else None,
            elected_labels_in=inputs.elected_labels if step.elected and reads_labels else None,
            elected_out=elected_name(number) if step.elects else None,
            labels_elected=step.elected and not is_last,
            candidates_only=candidates_only,
            input_candidates_only=reads_labels and inputs.candidates_only,
            held_bytes=held_bytes(plan.resources.memory),
        )
        digests = inputs.digests if reads_labels else assembled.digests
        near = plan.buckets.among(influence, digests)
        bucket_digests = [[c.ix, c.iy, digests[c]] for c in near]
        elected_digests = [inputs.elected_digests[c] for c in near] if step.elected else []
        points = sum(assembled.records[c].n for c in tile.cells)
        yield Task.of(
            f"filter{number}",
            f"t{tile.name}",
            calling(filter_tile, work=work),
            step.name,
            bucket_digests,
            elected_digests,
            points=points,
            bounds=plan.buckets.hull(tile.cells),
        )


def tile_records(filtered: Commits) -> Iterator[TileRecord]:
    """Yield the records of the tiles of a pass, from their commits."""
    return (TileRecord.of(stored) for _, stored in filtered.values())


def label_digests(assembled: IngestResult, filtered: Commits) -> dict[Cell, str]:
    """Return a digest for each bucket, of its contents and of the labels of its tile.

    If the tile of a bucket failed, the digest is that of a bucket without labels.
    """
    return _content_digests(assembled, ((tile, tile.labels) for tile in tile_records(filtered)))


def _content_digests(
    assembled: IngestResult, results: Iterable[tuple[TileRecord, str | None]]
) -> dict[Cell, str]:
    """Return a digest for each bucket, of its contents and of the result of its tile.

    ``results`` are the records of tiles, each with the digest of its result.
    """
    by_bucket: dict[Cell, str | None] = dict.fromkeys(assembled.records, "none")
    for tile, digest in results:
        by_bucket |= {Cell(*cell): digest for cell in tile.cells}
    return {
        cell: digest_of(digest, assembled.digests[cell]) for cell, digest in by_bucket.items()
    }
