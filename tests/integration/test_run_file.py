"""run.json: the paths that scripts use are there, and keep their names."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from tests.invariants import clouds
from tests.invariants.runs import do
from tiler.errors import ProcessingError, TilerError
from tiler.export.tasks import files as file_tasks
from tiler.io.result_folder import RUN

PAGE = Path(__file__).resolve().parents[2] / "docs/run-json.md"
NUMBER = (int, float)
PATHS: dict[str, Any] = {
    "state": str, "exit_code": int, "version": str, "configuration": dict, "given": list, "notes": list,
    "warnings": list, "counts.read": int, "counts.stored": int, "counts.dropped": dict, "classes.input": dict,
    "classes.no_part": dict, "classes.kept": dict, "classes.written": dict, "classes.ground": int, "inputs": list,
    "quarantined": list, "failed_tasks": list, "problems": list, "statistics.survey.survey.kind": str,
    "statistics.survey.survey.looks_like": (str, type(None)), "filter.points": int, "filter.ground": int,
    "dtm.width": int, "dtm.height": int, "dtm.resolution_m": NUMBER, "dtm.filled": int, "contours.interval": NUMBER,
    "above_returns.pixels": int, "above_returns.number": int, "above_returns.worst": list,
    "left_objects": list, "unsure": list,
    "implausible": list, "without_returns": list, "review.open": int, "review.ok": int,
    "review.fixed": int,
    "sigma.kind": str, "sigma.open.pixels": int, "sigma.open.rmse_m": NUMBER,
    "outputs": dict, "stages.<name>.seconds": NUMBER, "stages.<name>.peak_rss_bytes": int, "seconds": NUMBER,
    "peak_rss_bytes": int,
}  # fmt: skip
"""None of these may be renamed, moved or taken away, nor be of another type: scripts of users
read them."""
OF_MATCHED_CLOUDS = {"canopy.share", "canopy.mode", "canopy.places"}
"""Further paths in runs on matched clouds; `test_canopy` reads them."""
OF_SURVEYS = {"surveys"}
"""A path in runs with `--priority`; `test_priority` reads it."""
OF_LATER_RUNS = {"changes"}
"""A path in the second run of an OUT; `test_review` reads it."""


def values(content: Any, path: str) -> list[Any]:
    """What stands at a path; KeyError where nothing does."""
    found = [content]
    for name in path.split("."):
        found = [
            v for part in found for v in (part.values() if name == "<name>" else [part[name]])
        ]
    return found


def read(out: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((out / RUN).read_text())
    return content


def test_every_path_is_there_and_of_its_type(tmp_path: Path) -> None:
    cloud, out = clouds.write(tmp_path / "a.laz", clouds.city(60)), tmp_path / "out"
    for done_before in (False, True):
        result = do(cloud, out, method="auto", tile_size=None, products="dtm,contours,sigma")
        content = read(out)
        assert result.did_nothing == done_before
        assert json.loads(json.dumps(result.summary)) == content
        for path, kind in PATHS.items():
            found = values(content, path)
            assert found, path
            assert all(isinstance(v, kind) and not isinstance(v, bool) for v in found), path
        assert (content["state"], content["exit_code"]) == ("done", 0)
        assert (
            content["counts"]["read"] == content["inputs"][0]["points"] == len(clouds.city(60))
        )
        assert content["statistics"]["survey"]["survey"]["kind"] == "lidar"
        assert (
            content["dtm"]["width"],
            content["dtm"]["height"],
            content["dtm"]["resolution_m"],
        ) == (
            60,
            60,
            1.0,
        )
        assert {"dtm.tif", "contours.gpkg", "classified/a.laz"} <= content["outputs"].keys()


def test_every_path_is_promised_in_the_documentation() -> None:
    rows = (line for line in PAGE.read_text("utf-8").splitlines() if line.startswith("| `"))
    assert {path for row in rows for path in re.findall(r"`([^`]+)`", row.split("|")[1])} == (
        PATHS.keys() | OF_MATCHED_CLOUDS | OF_SURVEYS | OF_LATER_RUNS
    )


def test_what_was_left_out_is_warned_of_and_in_the_exit_code(tmp_path: Path) -> None:
    cloud, out = clouds.write(tmp_path / "in/a.laz", clouds.city(40)), tmp_path / "out"
    broken = tmp_path / "in/b.laz"
    broken.write_bytes(cloud.read_bytes()[:-3000])
    result = do([cloud, broken], out)
    content = read(out)
    assert content["exit_code"] == result.exit_code == 5
    assert [q["path"] for q in content["quarantined"]] == [broken.as_posix()]
    bounds = content["quarantined"][0]["bounds"]
    assert bounds == pytest.approx(
        content["inputs"][0]["bounds"][:2] + content["inputs"][0]["bounds"][3:5]
    )
    assert content["warnings"] == result.warnings
    assert any(text.startswith(f"{broken}: left out: ") for text in content["warnings"])


def test_a_refused_folder_of_kernels_is_noted_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    line = "/open: other users can write to it; set NUMBA_CACHE_DIR to another folder"
    monkeypatch.setattr("tiler.pipeline.cache_refusal", lambda: line)
    cloud, out = clouds.write(tmp_path / "a.laz", clouds.city(40)), tmp_path / "out"
    do(cloud, out, until="ingest")
    assert read(out)["notes"].count(line) == 1
    assert (out / "events.jsonl").read_text().count(line) == 1


@pytest.mark.parametrize(
    ("error", "state", "code"),
    [
        (ProcessingError("the disk is gone"), "failed", 4),
        (KeyboardInterrupt(), "interrupted", 130),
        (ValueError(), "failed", 4),
    ],
)
def test_a_run_that_ends_early_says_with_which_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException, state: str, code: int
) -> None:
    cloud, out = clouds.write(tmp_path / "a.laz", clouds.city(40)), tmp_path / "out"
    at_work: list[dict[str, Any]] = []

    def stop(*arguments: Any) -> Any:
        at_work.append(read(out))
        raise error

    monkeypatch.setattr("tiler.pipeline.export", stop)
    with pytest.raises(type(error)):
        do(cloud, out)
    assert [(c["state"], c["exit_code"]) for c in at_work] == [("running", None)]
    assert (read(out)["state"], read(out)["exit_code"]) == (state, code)
    monkeypatch.undo()
    do(cloud, out)
    assert (read(out)["state"], read(out)["exit_code"]) == ("done", 0)


def test_a_task_that_fails_is_warned_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cloud, out = clouds.write(tmp_path / "a.laz", clouds.city(40)), tmp_path / "out"

    def fails(*_: Any, **__: Any) -> dict[str, Any]:
        raise TilerError("no ink")

    monkeypatch.setattr(file_tasks, "write_classified", fails)
    result = do(cloud, out)
    assert read(out)["exit_code"] == result.exit_code == 5
    assert any(text.endswith("c000000 failed: no ink") for text in read(out)["warnings"])
