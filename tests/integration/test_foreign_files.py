"""What no run of an OUT made is neither replaced nor removed, and what one made is known again."""

from __future__ import annotations

import json
import os
import re
import uuid
from pathlib import Path
from typing import Any

import pytest

from tests.invariants.forked import ended, forked
from tests.invariants.runs import do, settings
from tests.scenes.folders import content
from tiler.errors import ConfigError, InputError, ProcessingError
from tiler.export import stage as export
from tiler.io.atomic_files import is_scratch, partial_path
from tiler.io.locations import as_path
from tiler.pipeline import run
from tiler.report.html import write_report

NAMES = ("dtm.tif", "run.json", "events.jsonl", "report.html", "classified/hill.laz")


def put(out: Path, *names: str) -> dict[str, bytes]:
    """Files of the user; their content."""
    for name in names:
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_bytes(b"mine, not a run's")
    return content(out)


@pytest.mark.parametrize("name", [*NAMES, "changed.json"])
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_first_run_replaces_nothing(
    name: str, overwrite: bool, cloud: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    before = put(out, name)
    with pytest.raises(
        ConfigError, match=rf"-o {re.escape(str(out))}: {name}: already exists .* or --force"
    ):
        do(cloud, out, overwrite=overwrite)
    assert content(out) == before


def test_all_of_them_are_named_and_forced(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    put(out, *NAMES, "notes.txt")
    every = "dtm.tif, classified/hill.laz, run.json, events.jsonl, report.html: "
    with pytest.raises(ConfigError, match=every):
        do(cloud, out)
    assert do(cloud, out, force=True).exit_code == 0
    assert json.loads((out / "run.json").read_text())["state"] == "done"
    assert (out / "notes.txt").read_bytes() == b"mine, not a run's"
    assert do(cloud, out).did_nothing, "now they are known"


def test_a_second_run_replaces_only_its_own_list_of_changes(
    cloud: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    do(cloud, out)
    (out / "changed.json").write_text('{"changed": "mine"}')
    with pytest.raises(ConfigError, match=r"changed\.json: already exists"):
        do(cloud, out, resolution="2")
    (out / "changed.json").unlink()
    assert do(cloud, out, resolution="2").exit_code == 0
    assert "dtm.tif" in json.loads((out / "changed.json").read_text())["changed"]
    assert do(cloud, out, resolution="1").exit_code == 0, "now it is known"


def test_a_list_of_changes_that_cannot_be_written_is_told(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    do(cloud, out)
    (out / "changed.json").mkdir()
    with pytest.raises(ProcessingError, match=r"changed\.json: cannot be written"):
        do(cloud, out, resolution="2", force=True)


@pytest.mark.parametrize("text", ["{", "{}"])
def test_the_remedy_for_a_damaged_run_file_works(
    text: str, cloud: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    do(cloud, out)
    (out / "run.json").write_text(text)
    with pytest.raises(InputError, match="run the same command again with --force"):
        write_report(out)
    with pytest.raises(ConfigError, match="already exists .* or --force"):
        do(cloud, out)
    assert do(cloud, out, force=True).exit_code == 0
    write_report(out)


@pytest.mark.parametrize(
    "text", ["", "{", "[1]", '{"outputs": {"dtm.tif": 1}, "name": "of another program"}']
)
def test_a_run_file_that_is_none_of_tiler_lists_nothing(
    text: str, cloud: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    put(out, "dtm.tif")
    (out / "run.json").write_text(text)
    before = content(out)
    with pytest.raises(ConfigError, match="dtm.tif, run.json: already exists"):
        do(cloud, out)
    assert content(out) == before


@pytest.mark.parametrize("kind", ["folder", "dangling link", "file for a folder"])
def test_what_is_no_file_is_in_the_way_as_well(kind: str, cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    if kind == "folder":
        put(out, "dtm.tif/notes.txt")
    elif kind == "dangling link":
        (out / "dtm.tif").symlink_to("nowhere")
    else:
        put(out, "classified")
    with pytest.raises(ConfigError, match="(dtm.tif|classified): already exists"):
        do(cloud, out)


def test_a_product_that_came_between_two_runs_is_the_users(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    do(cloud, out)
    before = put(out, "slope.tif", "dsm/dsm_0_0.tif", "dsm/plan.tif")
    with pytest.raises(ConfigError, match=r"slope\.tif: already exists"):
        do(cloud, out, products="dtm,slope")
    with pytest.raises(ConfigError, match="dsm/dsm_0_0.tif: already exists"):
        do(cloud, out, products="dsm", sheets="40")
    before |= put(out, "density")
    with pytest.raises(ConfigError, match="density: already exists"):
        do(cloud, out, products="density", sheets="40")
    with pytest.raises(
        ProcessingError, match=re.escape(f"{out / 'density'}: cannot be written")
    ):
        do(cloud, out, products="density", sheets="40", force=True)
    mine = {name: data for name, data in before.items() if data.startswith(b"mine")}
    assert content(out).items() >= mine.items()


def test_a_file_that_comes_while_the_run_goes_on_is_not_replaced(
    cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, cog_tasks = tmp_path / "out", export.cog_tasks

    def meanwhile(*arguments: Any) -> Any:
        put(out, "dtm.tif")
        return cog_tasks(*arguments)

    monkeypatch.setattr(export, "cog_tasks", meanwhile)
    with pytest.raises(ConfigError, match="dtm.tif: already exists"):
        do(cloud, out)
    assert (out / "dtm.tif").read_bytes() == b"mine, not a run's"


@pytest.mark.processes
@pytest.mark.parametrize(
    "where",
    [
        "runs.job.write_run_file",
        "export.rasters._publish",
        "export.classified.write_back",
        "export.stage._basis",
    ],
)
def test_a_killed_run_knows_its_own_files(where: str, cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert ended(forked(killed_at, where, cloud, out)) == 9
    assert do(cloud, out).exit_code == 0
    assert not [path for path in out.rglob(".tiler-*") if path.is_file()]


def killed_at(where: str, cloud: Path, out: Path) -> None:
    """A run that dies when it first gets somewhere."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(f"tiler.{where}", lambda *arguments: os._exit(9))
        do(cloud, out)


def test_a_file_whose_task_fails_stays_the_runs_own(
    cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    do(cloud, out)

    def fails(*arguments: Any) -> None:
        raise ProcessingError("no")

    monkeypatch.setattr("tiler.export.classified._write_points", fails)
    assert do(cloud, out, parameters={"iteration_distance": "1.2"}).exit_code == 5
    monkeypatch.undo()
    assert do(cloud, out, parameters={"iteration_distance": "1.2"}).exit_code == 0


def test_scratch_has_names_that_no_file_of_the_user_has(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    names = [
        f"{name}.partial"
        for name in ("dtm.tif.cog", "dtm.tif.plain", "run.json", "classified/hill.laz")
    ]
    before = put(out, *names)
    do(cloud, out)
    assert before.items() <= content(out).items()
    ours = [partial_path(Path(n), kind) for n in (*NAMES, "x" * 250) for kind in ("", "cog")]
    assert all(is_scratch(path.name) for path in ours)
    assert not any(map(is_scratch, names))


def test_at_a_url_as_well(cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("upath")
    monkeypatch.chdir(tmp_path)
    url = f"memory://{uuid.uuid4().hex}/town"
    for name in ("dtm.tif", "run.json"):
        as_path(f"{url}/{name}").write_bytes(b"mine")
    with pytest.raises(ConfigError, match="dtm.tif, run.json: already exists"):
        run([str(cloud)], url, settings())
    assert not (tmp_path / "town").exists()
    other = f"memory://{uuid.uuid4().hex}/town"
    assert run([str(cloud)], other, settings()).exit_code == 0
    with pytest.raises(ConfigError, match="dtm.tif, run.json: already exists"):
        run([str(cloud)], url, settings())  # what town/run.json lists is elsewhere
    assert as_path(f"{url}/dtm.tif").read_bytes() == b"mine"
    for path in (tmp_path / "town").iterdir():
        path.unlink()  # as from another machine
    assert run([str(cloud)], other, settings()).did_nothing
