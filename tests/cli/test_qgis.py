"""The plugin for QGIS without QGIS: its table, its folder and archive, and what it does with the command."""

from __future__ import annotations

import ast
import configparser
import importlib
import json
import os
import re
import sys
import threading
import zipfile
from email import message_from_string
from pathlib import Path
from types import ModuleType
from typing import Any

import click
import pytest

from cli.main import main
from cli.options import read_config
from cli.qgis import installation
from cli.qgis.table import NOT_IN_QGIS, SHELLS, table
from tiler.config import RunConfig
from tiler.io.result_folder import raster_file
from tiler.version import __version__

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted((ROOT / "cli/qgis/plugin").glob("*.py"))
OTHER_FILES = ("LICENSE", "icon.png", "metadata.txt", "settings.json")
ADDRESSES = {
    "homepage": "https://example.org",
    "tracker": "https://example.org/issues",
    "repository": "https://example.org/code",
    "email": "authors@example.org",
}
FACTS = f"""Metadata-Version: 2.4
Name: tiler-dtm
Author-email: the tiler authors <{ADDRESSES["email"]}>
Project-URL: Homepage, {ADDRESSES["homepage"]}
Project-URL: Issues, {ADDRESSES["tracker"]}
Project-URL: Repository, {ADDRESSES["repository"]}
"""
NO_ENUMS = ("Qgis.QGIS_VERSION", "QDialogButtonBox.StandardButton")
COMMAND = "tiler.exe" if os.name == "nt" else "tiler"
LINE = '{"stage": null, "title": "read", "progress": 0.5, "message": null, "level": "info"}'


@pytest.fixture
def plugins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of the plugins of a profile of its own."""
    monkeypatch.setenv("QGIS_CUSTOM_CONFIG_PATH", str(tmp_path))
    command = tmp_path / "scripts" / COMMAND
    command.parent.mkdir()
    command.touch(0o755)
    monkeypatch.setattr(sys, "argv", [str(command.with_suffix(""))])
    return tmp_path / "profiles/default/python/plugins"


@pytest.fixture
def process(plugins: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The plugin's module `process`, as it is installed."""
    assert main(["qgis", "install"]) == 0
    monkeypatch.syspath_prepend(str(plugins))
    for name in [name for name in sys.modules if name.split(".")[0] == installation.FOLDER]:
        monkeypatch.delitem(sys.modules, name)
    return importlib.import_module(f"{installation.FOLDER}.process")


def test_every_option_is_there_with_the_words_of_the_command_line() -> None:
    for name in SHELLS:
        command: click.Command = importlib.import_module(f"cli.commands.{name}").command
        entries = {entry["key"]: entry for entry in table()["commands"][name]["parameters"]}
        assert entries.keys() == {str(p.name) for p in command.params} - NOT_IN_QGIS
        for option in (
            p for p in command.params if isinstance(p, click.Option) and p.name in entries
        ):
            entry = entries[str(option.name)]
            assert str(option.help).startswith(entry["help"].split(" [")[0])
            assert f"unit: {entry['unit']}" in str(option.help) if entry["unit"] else True
            if isinstance(option.type, click.Choice):
                assert entry["choices"] == list(option.type.choices)


def test_each_algorithm_has_an_input_of_a_kind_that_qgis_knows() -> None:
    inputs = {
        name: next(p["kind"] for p in command["parameters"] if p["name"] == "INPUT")
        for name, command in table()["commands"].items()
    }
    assert inputs == {
        "run": "clouds",
        "preview": "clouds",
        "classify": "cloud",
        "check": "raster",
    }


def test_rasters_are_found_by_the_names_of_the_run(process: ModuleType) -> None:
    for names in (None, "dtm=MNT", "mask = Quelle é,dtm=a=b"):
        config = RunConfig.from_mapping({"product_name": names}).to_json()
        for product in ("dtm", "mask"):
            assert process.raster_file(config, product) == raster_file(product, names)
    assert process.raster_file({}, "dtm") == "dtm.tif"


def test_settings_of_a_run_become_the_same_settings(process: ModuleType) -> None:
    """By way of run.json and the options that the plugin makes of it."""
    given: dict[str, Any] = {
        "preset": "usgs", "method": "classic", "parameters": ["max_building_size_m=40"], "products": "dtm,mask",
        "resolution": "3ft", "voids": "mark", "breaklines": ["a.gpkg", "b.gpkg"], "keep_classes": "none",
        "bounds": (-1.5, 2.0, 3.0, 4.25), "skip_overlap": True, "workers": 3, "nodata": "-32768", "memory": "2GiB",
    }  # fmt: skip
    config = RunConfig.from_mapping(given)
    options = process.options_of_config("run", json.loads(json.dumps(config.to_json())))
    command: click.Command = importlib.import_module("cli.commands.run").command
    parsed = command.make_context("run", [*options, "-o", "out", "a.laz"]).params
    assert read_config(parsed) == config.updated(preset=None)
    assert process.options_of_config("run", RunConfig().to_json()) == []


def test_what_is_left_at_its_default_is_not_given(process: ModuleType) -> None:
    for entry in process.TABLE["commands"]["run"]["parameters"]:
        assert process.options(entry, entry["default"]) == []
        assert process.options(entry, None) == []


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: p.name)
def test_runs_on_the_python_of_old_qgis_and_imports_nothing_else(path: Path) -> None:
    tree = ast.parse(path.read_text("utf-8"), feature_version=(3, 9))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [name.name for name in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names = [node.module or ""]
        else:
            continue
        assert {name.split(".")[0] for name in names} <= {
            *sys.stdlib_module_names,
            "qgis",
            "processing",
        }


def test_an_archive_that_qgis_takes_and_that_is_always_the_same(tmp_path: Path) -> None:
    packages = [tmp_path / "a.zip", tmp_path / "b.zip"]
    for package in (*packages, packages[1]):
        assert main(["qgis", "package", str(package)]) == 0
    assert packages[0].read_bytes() == packages[1].read_bytes()
    with zipfile.ZipFile(packages[0]) as archive:
        assert {name.split("/")[0] for name in archive.namelist()} == {installation.FOLDER}
        metadata = configparser.ConfigParser()
        metadata.read_string(archive.read(f"{installation.FOLDER}/metadata.txt").decode())
        content = json.loads(archive.read(f"{installation.FOLDER}/settings.json"))
        names = {Path(name).name for name in archive.namelist()}
        assert names == {*(p.name for p in SOURCES), *OTHER_FILES}
        assert archive.read(f"{installation.FOLDER}/LICENSE") == (ROOT / "LICENSE").read_bytes()
        assert archive.read(f"{installation.FOLDER}/{metadata['general']['icon']}").startswith(
            b"\x89PNG"
        )
    general = metadata["general"]
    assert {
        "name",
        "qgisMinimumVersion",
        "description",
        "about",
        "version",
        "author",
        "email",
    } <= general.keys()
    assert general["hasProcessingProvider"] == "yes"
    assert general["version"] == content["version"]
    assert general["changelog"].splitlines()[0] == __version__
    assert content["command"] == "", "another machine has it elsewhere"


@pytest.mark.parametrize("lacking", [*ADDRESSES, None])
def test_nothing_is_packaged_for_upload_without_the_addresses(
    lacking: str | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """They come from the facts of the installed package, which `pyproject.toml` makes."""
    lines = [
        line for line in FACTS.splitlines() if not line.endswith(tuple(taken_out(lacking)))
    ]
    facts = message_from_string("\n".join(lines))
    monkeypatch.setattr("cli.qgis.installation.metadata", lambda name: facts)
    target = tmp_path / "a.zip"
    code = main(["qgis", "package", "--upload", str(target)])
    if lacking is not None:
        assert code == 2
        assert not target.exists()
        assert (
            "which the repository of QGIS plugins requires; add the missing values"
            in capsys.readouterr().err
        )
        return
    assert code == 0
    with zipfile.ZipFile(target) as archive:
        metadata = configparser.ConfigParser()
        metadata.read_string(archive.read(f"{installation.FOLDER}/metadata.txt").decode())
    assert {key: metadata["general"][key] for key in ADDRESSES} == ADDRESSES


def taken_out(lacking: str | None) -> list[str]:
    """Ends of the lines of `FACTS` that hold an address."""
    if lacking is None:
        return []
    return [f" {ADDRESSES[lacking]}", f"<{ADDRESSES[lacking]}>"]


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: p.name)
def test_enums_are_named_in_full_as_qt6_asks(path: Path) -> None:
    """``QgsX.Enum.Member``, and not ``QgsX.Member``; classes within classes are called, and are no enums."""
    tree = ast.parse(path.read_text("utf-8"))
    fine = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    fine |= {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    fine |= {
        id(base)
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
        for base in node.bases
    }
    for node in ast.walk(tree):
        if (
            not isinstance(node, ast.Attribute)
            or not isinstance(node.value, ast.Name)
            or id(node) in fine
        ):
            continue
        is_qt = re.match(r"Q(gs|t)?[A-Z]|Qt$|Qgis$", node.value.id) is not None
        named = f"{node.value.id}.{node.attr}"
        assert not (is_qt and node.attr[0].isupper()) or named in NO_ENUMS, (
            f"{path.name}: {named}"
        )


def test_no_foreign_archive_is_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    foreign = tmp_path / "a.zip"
    foreign.write_bytes(b"mine")
    assert main(["qgis", "package", str(foreign)]) == 2
    assert foreign.read_bytes() == b"mine"
    assert capsys.readouterr().err.startswith(
        f"tiler: error: {foreign}: already exists and is not a package"
    )


def test_installed_again_over_an_earlier_version(
    plugins: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["qgis", "install"]) == 0
    told = capsys.readouterr().out
    folder = plugins / installation.FOLDER
    assert str(folder) in told
    assert "remove" in told
    names = {p.name for p in folder.iterdir()}
    content = json.loads((folder / "settings.json").read_text())
    assert Path(content["command"]) == tmp_path / "scripts" / COMMAND
    (folder / "old.py").write_text("of an earlier version")
    (folder / "settings.json").write_text(
        json.dumps({**content, "files": [*content["files"], "old.py", "../x"]})
    )
    (folder / "mine.txt").write_text("of the user")
    (folder / "styles.py").write_text("damaged")
    assert main(["qgis", "install"]) == 0
    assert {p.name for p in folder.iterdir()} == {*names, "mine.txt"}
    assert (folder / "styles.py").read_bytes() == (
        ROOT / "cli/qgis/plugin/styles.py"
    ).read_bytes()


@pytest.mark.parametrize("kind", ["folder", "link", "file"])
def test_no_foreign_folder_is_touched(
    kind: str, plugins: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = plugins / installation.FOLDER
    other = folder if kind == "folder" else tmp_path / "checkout"
    if kind != "file":
        other.mkdir(parents=True)
        (other / "metadata.txt").write_text("mine")
    plugins.mkdir(parents=True, exist_ok=True)
    if kind == "link":
        folder.symlink_to(other)
    elif kind == "file":
        folder.write_text("mine")
    assert main(["qgis", "install"]) == 2
    assert (
        "was not written by `tiler qgis install`; remove or rename it first"
        in capsys.readouterr().err
    )
    assert (folder if kind == "file" else other / "metadata.txt").read_text() == "mine"
    assert kind == "file" or [p.name for p in other.iterdir()] == ["metadata.txt"]


def test_an_unknown_profile_is_named(plugins: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (plugins.parents[2] / "work").mkdir(parents=True)
    assert main(["qgis", "install", "--profile", "wrok"]) == 2
    error = capsys.readouterr().err
    assert "has no QGIS profile 'wrok', only: work" in error
    assert main(["qgis", "install", "--profile", "work"]) == 0


def script(path: Path, text: str) -> list[str]:
    """A command that stands in for ``tiler``."""
    path.write_text(f"import os, signal, sys, time\n{text}")
    return [sys.executable, str(path)]


def test_a_command_is_found_or_one_line_says_what_to_do(
    process: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "")
    for home in ("HOME", "USERPROFILE"):
        monkeypatch.setenv(home, str(tmp_path))
    for configured, where in (("", "PATH"), ("/none/tiler", "/none/tiler")):
        with pytest.raises(
            process.CommandError, match=f"^{where}: the command tiler was not found; install it"
        ):
            process.find_command(configured)
    local = tmp_path / ".local/bin" / COMMAND
    local.parent.mkdir(parents=True)
    local.touch(0o755)
    assert process.find_command("") == str(local)


def test_the_version_of_a_command_tells_whether_it_is_the_right_one(
    process: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, first, hang = tmp_path / "tiler", "#!/bin/sh\n", "exec sleep 60\n"
    if os.name == "nt":
        path, first, hang = path.with_suffix(".bat"), "@", ":again\n@goto again\n"
    for text, told in (
        (f"echo tiler, version {__version__}", None),
        ("echo hello", "is not the command tiler"),
    ):
        path.write_text(f"{first}{text}\n")
        path.chmod(0o755)
        if told is None:
            assert process.version_of(str(path)) == __version__
        else:
            with pytest.raises(process.CommandError, match=told):
                process.version_of(str(path))
    monkeypatch.setattr(process, "TEST_SECONDS", 0.1)
    path.write_text(f"{first}{hang}")
    with pytest.raises(process.CommandError, match="did not answer within"):
        process.version_of(str(path))


@pytest.mark.processes
def test_what_a_command_says_is_passed_on(
    process: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PROJ_LIB", "/of/qgis")
    told: list[dict[str, Any]] = []
    call = script(
        tmp_path / "a",
        f"print({LINE!r}, file=sys.stderr)\n"
        "print(os.environ.get('PROJ_LIB', 'unset'), '\\u011b')\n"
        "print('odd', file=sys.stderr)\n"
        "sys.exit(5)\n",
    )
    ended = process.run_command(call, told.append, lambda: False)
    assert (ended.code, ended.text.split(), ended.cancelled) == (5, ["unset", "\u011b"], False)
    assert [event["message"] for event in told] == [None, "odd"]
    assert told[0]["progress"] == 0.5


@pytest.mark.parametrize(
    "line",
    [
        '{"level": "error", "message": "tiler: error: no such file"}',
        "tiler: error: no such file",
    ],
)
def test_an_error_is_the_line_of_the_command(
    line: str, process: ModuleType, tmp_path: Path
) -> None:
    with pytest.raises(process.CommandError, match=r"^no such file$"):
        process.run_command(
            script(tmp_path / "a", f"print({line!r}, file=sys.stderr)\nsys.exit(3)"),
            lambda event: None,
            lambda: False,
        )
    with pytest.raises(process.CommandError, match="ended with code 137 and without a message"):
        process.run_command(
            script(tmp_path / "b", "sys.exit(137)"), lambda event: None, lambda: False
        )


@pytest.mark.processes
def test_cancel_tells_the_command_and_waits_for_its_end(
    process: ModuleType, tmp_path: Path
) -> None:
    begun, stop = threading.Event(), tmp_path / "stopped"
    text = (
        f"def end(*_):\n    time.sleep(0.2)\n    open({str(stop)!r}, 'w')\n    sys.exit(130)\n"
        f"signal.signal(signal.SIGTERM, end)\nprint({LINE!r}, file=sys.stderr)\ntime.sleep(900)\n"
    )
    ended = process.run_command(
        script(tmp_path / "a", text), lambda event: begun.set(), begun.is_set
    )
    assert ended.cancelled
    assert stop.exists() == (os.name != "nt"), "Windows kills it"
