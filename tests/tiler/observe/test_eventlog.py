"""events.jsonl: one whole JSON object a line, even after a killed run."""

from __future__ import annotations

import json
from datetime import datetime, timedelta
from pathlib import Path

from tiler.observe.events import Note, RunFinished
from tiler.observe.json_lines import EventLog


def lines(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_text("utf-8").splitlines()]


def test_a_line_is_in_the_file_at_once(tmp_path: Path) -> None:
    path = tmp_path / "out" / "events.jsonl"
    with EventLog(path) as log:
        log(Note("Höhe in m\nzweite Zeile"))
        (line,) = lines(path)
    assert line["event"] == "note"
    assert line["text"] == "Höhe in m\nzweite Zeile"
    assert datetime.fromisoformat(str(line["time"])).utcoffset() == timedelta(0)


def test_runs_are_appended(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    for _ in range(2):
        with EventLog(path) as log:
            log(RunFinished(1.5))
    assert [line["event"] for line in lines(path)] == ["run_finished", "run_finished"]


def test_an_unfinished_line_does_not_spoil_the_next(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    path.write_text('{"event": "no', "utf-8")
    with EventLog(path) as log:
        log(Note("again"))
    assert json.loads(path.read_text("utf-8").splitlines()[-1])["text"] == "again"


def test_values_that_json_cannot_hold_become_text(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    with EventLog(path) as log:
        log(Note(Path("a/b")))  # type: ignore[arg-type]
    assert lines(path)[0]["text"] == str(Path("a/b"))
