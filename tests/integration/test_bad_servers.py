"""Clouds on servers that fail: a line each, and the clouds of the other servers are processed."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("upath", reason="no URLs: universal-pathlib is not installed")
pytest.importorskip("aiohttp", reason="no http: aiohttp is not installed")

from cli.main import main
from tests.integration.command import assert_one_line
from tests.invariants import clouds
from tests.invariants.runs import settings
from tests.tiler.servers import http_server
from tiler.pipeline import run
from tiler.plan import make_plan

FAULTS = {
    "half": "its server sent 8,192 of the 16,384 bytes requested",
    "broken": "the connection to its server broke",
    "401": "its server answered 401 Unauthorized",
    "403": "its server answered 403 Forbidden",
    "404": "its server answered 404 Not Found",
    "500": "its server answered 500 Internal Server Error",
    "dead": "its server 127.0.0.1 cannot be reached: ",
}
"""What a server does, and how it is told."""
REMEDY = "; check the URL, its server and your credentials, or download it"


@contextmanager
def failing_server(folder: Path, fault: str) -> Iterator[str]:
    if fault == "dead":
        with socket.socket() as unused:  # Bound, but nothing listens there.
            unused.bind(("127.0.0.1", 0))
            yield f"http://127.0.0.1:{unused.getsockname()[1]}"
    else:
        with http_server(folder, fault=fault) as server:
            yield server


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A good cloud, and one for the server."""
    folder = tmp_path_factory.mktemp("served")
    clouds.write(folder / "good.laz", clouds.city(40.0, 1.0))
    clouds.write(folder / "bad.laz", clouds.city(60.0, 1.0))
    return folder


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("command", ["info", "plan"])
def test_a_failing_server_is_one_line_and_3(
    command: str, fault: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with failing_server(folder, fault) as server:
        assert main([command, f"{server}/bad.laz"]) == 3
    line = f"{server}/bad.laz: cannot be read ({FAULTS[fault]}"
    assert_one_line(capsys.readouterr().err, line, REMEDY)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_failing_server_is_left_out_of_a_plan_with_other_clouds(
    fault: str, folder: Path
) -> None:
    with failing_server(folder, fault) as server:
        plan = make_plan([str(folder / "good.laz"), f"{server}/bad.laz"], settings())
    ((path, reason),) = plan.inputs.left_out
    assert path == f"{server}/bad.laz"
    assert FAULTS[fault] in reason
    assert [source.path.name for source in plan.inputs.sources] == ["good.laz"]


@pytest.mark.parametrize("name", ["", "*.laz", "all.vpc", "ept.json"])
def test_what_a_server_does_not_list_is_left_out(
    name: str, folder: Path, tmp_path: Path
) -> None:
    """It alone is an error of the input."""
    with failing_server(folder, "500") as server:
        url = f"{server}/{name}"
        result = run([str(folder / "good.laz"), url], tmp_path / "out", settings())
    assert result.exit_code == 5
    ((lost),) = result.summary["quarantined"]
    assert lost["path"] == url
    assert FAULTS["500"] in lost["error"]


def test_a_folder_that_no_server_lists_is_one_line_and_3(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with failing_server(folder, "403") as server:
        for command in ("plan", "info"):
            assert main([command, f"{server}/a/"]) == 3
            assert_one_line(capsys.readouterr().err, f"{server}/a/: cannot be ", FAULTS["403"])


def test_other_commands_say_the_same_of_a_failing_server(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with failing_server(folder, "500") as server:
        cloud, raster = f"{server}/bad.laz", f"{server}/dtm.tif"
        commands = [
            ["classify", cloud, str(tmp_path / "out.laz"), "--method", "classic"],
            ["check", raster, "--points", str(folder / "points.csv")],
        ]
        (folder / "points.csv").write_text("x,y,z\n1,1,1\n")
        for command in commands:
            assert main(command) == 3
            assert_one_line(capsys.readouterr().err, f"{command[1]}: cannot be read (", REMEDY)
