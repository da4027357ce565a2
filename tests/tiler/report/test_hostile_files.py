"""Files in OUT that are damaged: the report is drawn without them, or one line names the one that is to blame."""

from __future__ import annotations

import json
import random
from pathlib import Path

import numpy as np
import pytest

from cli.main import main
from tests.tiler.apps.check.rasters import tilted, write_surface
from tests.tiler.junk import spoilt
from tests.tiler.report import results
from tiler.apps.check import Checkpoints, PointOptions, check_dtm, judge, parse_requirements
from tiler.apps.info import describe
from tiler.errors import ConfigError, InputError
from tiler.io.result_folder import earlier_statistics
from tiler.report.html import write_report


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return results.write(tmp_path / "out", results.run(outputs={}))


def measured(folder: Path) -> dict[str, object]:
    """What `tiler check --json` says, of a few checkpoints."""
    xy = [[5.5, 10.5, 20.5], [5.5, 20.5, 30.5]]
    kinds = ("NVA", "NVA", "VVA")
    points = Checkpoints(
        *map(np.array, (xy, [100.0, 99.0, 101.0])), kinds, ("grass",) * 3, ("a", "b", "c")
    )  # type: ignore[arg-type]
    report = {
        "accuracy": check_dtm(write_surface(folder / "dtm.tif", tilted), points, PointOptions())
    }
    seams = {"unit": "metre", "interior": {"pairs": 7, "mean_step": 0.1}, "excess": None}
    return {
        **report,
        "seams": seams,
        "strips": results.STRIPS,
        "requirements": judge(parse_requirements(["rmse=0.1"]), report),
    }


@pytest.mark.parametrize("name", ["check.json", "evaluate.json"])
def test_what_was_measured_with_junk_anywhere(name: str, out: Path, tmp_path: Path) -> None:
    document = json.loads(
        json.dumps(results.EVALUATION if name == "evaluate.json" else measured(tmp_path))
    )
    (out / name).write_text(json.dumps(document))
    assert name not in results.read(write_report(out)).texts["accuracy"]
    blamed = 0
    for changed in random.Random(1).sample(list(spoilt(document)), 120):
        (out / name).write_text(json.dumps(changed))
        blamed += f"{name}: " in results.read(write_report(out)).texts["accuracy"]
    assert blamed > 20


@pytest.mark.parametrize("content", ["[" * 100_000, "[1]", "\0", "5"])
def test_what_was_measured_is_no_object(content: str, out: Path) -> None:
    (out / "check.json").write_text(content)
    assert "check.json: " in results.read(write_report(out)).texts["accuracy"]


def test_a_damaged_log_costs_the_times_alone(out: Path) -> None:
    run = results.run(outputs={})
    for tile in run["tiles"]["filter0"]:
        tile["seconds"] = None
    results.write(out, run)
    done = {
        "event": "task_done",
        "stage": "filter0",
        "key": "t+000+000",
        "seconds": 5,
        "peak_rss_bytes": 6,
    }
    lines = [json.dumps(changed) for changed in spoilt(done)] + [
        "[" * 100_000,
        "5",
        "{",
        json.dumps(done),
    ]
    (out / "events.jsonl").write_text("\n".join(lines))
    times = {
        row[0]: row[7] for row in results.read(write_report(out)).data["stages"][0]["tiles"]
    }
    assert times["t+000+000"] == 5


def test_a_run_with_junk_anywhere(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever reads run.json either can, or says that it is to blame."""
    document = results.run(outputs={})
    for changed in random.Random(2).sample(list(spoilt(document)), 120):
        (out / "run.json").write_text(json.dumps(changed))
        for read in (write_report, lambda folder: describe(str(folder))):
            try:
                read(out)
            except InputError as error:
                said = str(error)
                assert str(out / "run.json") in said
        assert main(["info", str(out)]) in (0, 3)
        assert "unexpected" not in capsys.readouterr().err
        try:
            earlier_statistics(out, "classic", document["plan"]["parameters"])
        except ConfigError as error:
            said = str(error)
            assert str(out) in said
