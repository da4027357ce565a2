"""Many files are looked into by several processes; the plan is that of one."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.tiler.conftest import MakeCloud
from tiler.config import RunConfig
from tiler.errors import InputError
from tiler.io.locations import as_path
from tiler.plan import make_plan, plan_json
from tiler.plan.inspection import FILES_PER_READER, MAX_URL_READERS, reading_processes


@pytest.fixture
def folder(make_cloud: MakeCloud, tmp_path: Path) -> Path:
    """Twenty-four files, of which two are damaged, each in its own way."""
    for i in range(24):
        make_cloud(f"in/{i:02d}.las", n=20 + i, seed=i)
    (tmp_path / "in/07.las").write_bytes(b"LASF")
    whole = (tmp_path / "in/23.las").read_bytes()
    (tmp_path / "in/23.las").write_bytes(whole[:-10])
    return tmp_path / "in"


def test_the_plan_is_the_same_with_any_number_of_reading_processes(folder: Path) -> None:
    found = []
    for values in ({"in_process": True}, {"workers": 1}, {"workers": 3}):
        plan = make_plan(
            [str(folder)], RunConfig.from_mapping({"workers": 1, "memory": 1 << 30, **values})
        )
        found.append(
            (
                {**plan_json(plan), "workers": None, "projected_seconds": None},
                plan.inputs.sources,
            )
        )
    assert found[0] == found[1] == found[2]
    assert [Path(path).name for path, _ in found[0][0]["unreadable"]] == ["07.las", "23.las"]
    assert [s.points for s in found[0][1]] == [20 + i for i in range(24) if i not in (7, 23)]


def test_the_first_damaged_file_ends_a_strict_plan(folder: Path) -> None:
    with pytest.raises(InputError, match=r"07\.las: "):
        make_plan([str(folder)], RunConfig.from_mapping({"workers": 3, "on_error": "stop"}))


def test_a_reader_is_started_where_it_pays() -> None:
    config = RunConfig(workers=4)
    pytest.importorskip("upath")

    def readers(near: int, far: int = 0) -> int:
        return reading_processes(
            [Path("x.las")] * near + [as_path("memory://x/y.las")] * far, config
        )

    assert [readers(n) for n in (1, FILES_PER_READER, FILES_PER_READER + 1, 10_000)] == [
        1,
        1,
        2,
        4,
    ]
    assert [readers(0, n) for n in (1, FILES_PER_READER + 1, 10_000)] == [1, 2, MAX_URL_READERS]
