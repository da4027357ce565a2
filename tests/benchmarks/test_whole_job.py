"""The benchmark of the whole job runs, and its figures fit together."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.benchmarks import purposes
from tests.benchmarks.whole_job import REST, Cost, JobCost, measure, median, table
from tests.invariants import clouds


def test_stages_add_up_to_the_whole_job(tmp_path: Path) -> None:
    path = clouds.write(tmp_path / "city.laz", clouds.city(64.0, 1.0))
    job = measure([path], {"in_process": True, "method": "rarefy"}, tmp_path / "out")
    assert job.points > 3000
    assert job.worker_bytes > 0
    assert sum(cost.cpu for cost in job.stages.values()) == pytest.approx(job.total.cpu)
    assert sum(cost.wall for cost in job.stages.values()) == pytest.approx(job.total.wall)
    assert {"read the clouds", "grid: terrain", REST} <= set(job.stages)
    assert (tmp_path / "out/dtm.tif").exists()
    assert "| **whole job** |" in table(job)


def test_purposes_add_up_to_the_profile(tmp_path: Path) -> None:
    path = clouds.write(tmp_path / "city.laz", clouds.city(64.0, 1.0))
    found = purposes.profile([path], {"method": "rarefy"}, tmp_path / "out")
    assert found.seconds.keys() == purposes.PURPOSES.keys()
    assert found.seconds["LAZ: decode"] > 0
    assert found.seconds["store: unpack chunks"] > 0
    assert found.times_unpacked(3000) > 1
    text = purposes.table(found, 3000)
    assert f"| {sum(found.seconds.values()):.2f} | 100.0% |" in text


@pytest.mark.parametrize(
    ("function", "purpose"),
    [
        (
            "~:<method 'decompress_many' of 'builtins.LasZipDecompressor' objects>",
            "LAZ: decode",
        ),
        ("~:<numcodecs.blosc.decompress>", "store: unpack chunks"),
        ("/a/ptd/tin/bulk.py:build", "triangulate and scan TINs"),
        ("/a/ptd/ground/labelling.py:label", "filter and surfaces"),
        ("~:<method 'astype' of 'numpy.ndarray' objects>", "numpy and scipy"),
        ("~:<built-in method builtins.len>", "other Python"),
    ],
)
def test_each_function_has_a_purpose(function: str, purpose: str) -> None:
    assert purposes.purpose_of(function) == purpose


def test_medians_and_multiples() -> None:
    jobs = [
        JobCost(1_000_000, Cost(2.0, 4.0), Cost(cpu, 8.0), {REST: Cost(cpu, 8.0)}, 10**8, 10**8)
        for cpu in (30, 16, 18)
    ]
    assert "| **whole job** | 18.0 | 8.0 | 9.00 | 2.00 |" in table(median(jobs))
    assert "1,000,000 points, 18.00 CPU s a million." in table(median(jobs))
