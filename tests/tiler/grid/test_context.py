"""The rule for ground points that all tasks of the stage grid share."""

from __future__ import annotations

from pathlib import Path

from tests.invariants import clouds
from tiler.config import RunConfig
from tiler.core.digests import digest_of
from tiler.core.edits import Edits
from tiler.core.lattice import Lattice
from tiler.grid.tasks.gridding import Corrections, GridContext, ground_rule
from tiler.plan import make_plan
from tiler.runs.found import IngestResult


def test_every_task_that_reads_ground_gets_the_edits(tmp_path: Path) -> None:
    """Also those that find water; which edits are near is in the digests of the labels, not in the rule's."""
    cloud = clouds.write(tmp_path / "in.laz", clouds.city(20.0, 1.0))
    plan = make_plan([str(cloud)], RunConfig.from_mapping({"in_process": True}))
    assert GridContext(plan, IngestResult({}, {}), {}).rule.edits is None
    edits = Edits((), Lattice(1))
    rule = GridContext(plan, IngestResult({}, {}), {}, corrections=Corrections(edits)).rule
    assert rule.edits == edits.key
    assert digest_of(rule) == digest_of(ground_rule(plan))
