"""The log of a run that is not on a terminal: decisions, warnings and a summary, and each decision once."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cli.main import main
from tests.invariants import clouds
from tiler.observe import progress

pytestmark = pytest.mark.usefixtures("logging_as_before")

MAX_LINES = 25
STAGES = ("read the clouds: ", "filter: ", "grid: ", "write the files: ")
DECISIONS = (
    "the CRS is WGS 84 / UTM zone 32N, from the files, data at 48.75° N, 9.00° E; x and y are in metres",
    "heights are assumed to be in metres, like x and y, because there is no vertical CRS in 2 of 2 files (--units h,v)",
    "decided: pixels of 1 m, the default for clouds of this density (--resolution)",
)


def test_log_has_decisions_once_and_stages_only_with_v(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "_MIN_SECONDS", 0.0)  # The stages of small clouds are short.
    for name in ("a.laz", "b.laz"):
        clouds.write(tmp_path / name, clouds.city(60.0))
    out = tmp_path / "out"

    def log(*options: str) -> list[str]:
        files = [str(tmp_path / name) for name in ("a.laz", "b.laz")]
        arguments = ["run", *files, "-o", str(out), "--in-process"]
        assert main([*arguments, *options]) == 0
        output = capsys.readouterr()
        return [*output.err.splitlines(), *output.out.splitlines()]

    first, second, verbose = log(), log(), log("-v", "--overwrite")
    assert len(first) <= MAX_LINES, first
    assert set(DECISIONS) <= set(first)
    assert any(line.startswith("decided: laser scanning (") for line in first)
    assert not [line for line in first if line.startswith(STAGES)]

    assert second[0] == "nothing to do: all results are up to date"
    assert not set(DECISIONS) & set(second)
    assert not [line for line in second if line.startswith("decided: ")]

    assert set(first) - set(verbose) <= {
        line for line in first if line.startswith(("time ", "memory "))
    }
    for stage in STAGES:
        assert [line for line in verbose if line.startswith(stage)], stage
    (doubles,) = [line for line in verbose if "duplicate points" in line]
    assert "0" not in doubles.split()

    events = [json.loads(line) for line in (out / "events.jsonl").read_text().splitlines()]
    notes = [event["text"] for event in events if event["event"] == "note"]
    assert all(notes.count(text) == 3 for text in DECISIONS), (
        "events have the notes of each run"
    )
