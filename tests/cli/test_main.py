"""Exit codes, one line for each error, and help: what scripts and people hold on to."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import click
import pytest

from cli.commands.check import command as check
from cli.commands.run import command as run
from cli.help import GROUPS, OTHER_PROGRAMS, OWN, options_in
from cli.main import COMMANDS, STAGES, LazyGroup, group, main
from tests.waiting import PATIENCE_SECONDS
from tiler.errors import ConfigError, InputError, LockedError, ProcessingError, StoreError

ROOT = Path(__file__).resolve().parents[2]


def failing_plan(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    def make_plan(*arguments: Any) -> None:
        raise error

    monkeypatch.setattr("tiler.apps.resolutions.make_plan", make_plan)


class Panic(BaseException):
    """What a library in another language raises when it gives up: no Exception."""


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (ConfigError("halo -1: must be above 0"), 2, "halo -1: must be above 0"),
        (LockedError("OUT is locked by pid 7"), 2, "OUT is locked by pid 7"),
        (InputError("a.laz: cut short"), 3, "a.laz: cut short"),
        (StoreError("store.zarr: damaged"), 4, "store.zarr: damaged"),
        (ProcessingError("disk full\nreally"), 4, "disk full really"),
        (
            ValueError("odd"),
            4,
            "unexpected ValueError: odd; run the same command with -vv for the traceback",
        ),
        (
            MemoryError(),
            4,
            "unexpected MemoryError; run the same command with -vv for the traceback",
        ),
        (
            Panic("index"),
            4,
            "unexpected Panic: index; run the same command with -vv for the traceback",
        ),
    ],
)
def test_errors_are_one_line_with_their_exit_code(
    error: BaseException,
    code: int,
    text: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    failing_plan(monkeypatch, error)
    assert main(["plan", "a.laz"]) == code
    captured = capsys.readouterr()
    assert captured.err == f"tiler: error: {text}\n"
    assert captured.out == ""


def test_traceback_with_vv_only(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    failing_plan(monkeypatch, InputError("a.laz: cut short"))
    assert main(["plan", "a.laz", "-v"]) == 3
    assert "Traceback" not in capsys.readouterr().err
    assert main(["plan", "a.laz", "-vv"]) == 3
    error = capsys.readouterr().err
    assert "Traceback" in error
    assert error.endswith("tiler: error: a.laz: cut short\n")


@pytest.mark.parametrize("error", [KeyboardInterrupt(), click.Abort()])
def test_interrupt(
    error: BaseException,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    failing_plan(monkeypatch, error)
    assert main(["plan", "a.laz"]) == 130
    assert capsys.readouterr().err.strip() == "tiler: interrupted"

    def run(*arguments: Any, **settings: Any) -> None:
        raise error

    monkeypatch.setattr("tiler.apps.resolutions.run", run)
    assert main(["run", "a.laz", "-o", str(tmp_path)]) == 130
    assert (
        capsys.readouterr().err.strip()
        == "tiler: interrupted; run the same command again to resume"
    )


def waiting(folder: Path) -> subprocess.Popen[str]:
    """A command that is at work, in a process of its own."""
    (folder / "waiting.py").write_text(
        "import sys, time\n"
        "from unittest import mock\n"
        "import cli.ending, tiler.apps.info\n"
        "from cli.main import main\n"
        "cli.ending.GRACE_SECONDS = 900\n"
        "def wait(path):\n"
        "    print('ready', flush=True)\n"
        "    for _ in range(9000):\n"
        "        time.sleep(0.1)  # on Windows, Ctrl-Break does not end a sleep\n"
        "with mock.patch('tiler.apps.info.describe', wait):\n"
        "    sys.exit(main(['info', 'x']))\n"
    )
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    here = {**os.environ, "PYTHONPATH": str(ROOT)}
    pipes["creationflags"] = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)
    process = subprocess.Popen([sys.executable, folder / "waiting.py"], env=here, **pipes)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


def end_of(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Exit code and last words; whatever becomes of it, it is gone afterwards."""
    try:
        _, error = process.communicate(timeout=PATIENCE_SECONDS)
    finally:
        process.kill()
        process.communicate()
    return process.returncode, error.strip()


@pytest.mark.processes
@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize(
    "number",
    [signal.CTRL_BREAK_EVENT] if sys.platform == "win32" else [signal.SIGINT, signal.SIGTERM],
)
def test_signals_end_a_process_with_130(number: signal.Signals, tmp_path: Path) -> None:
    process = waiting(tmp_path)
    try:
        process.send_signal(number)
    except OSError as error:
        process.kill()
        process.communicate()
        pytest.skip(f"no console: {error}")
    assert end_of(process) == (130, "tiler: interrupted")


@pytest.mark.processes
@pytest.mark.skipif(os.name == "nt", reason="signals cannot be sent here")
@pytest.mark.usefixtures("interruptible")
def test_in_the_background_of_a_script_ctrl_c_is_ignored(tmp_path: Path) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a shell starts such a job
    process = waiting(tmp_path)
    process.send_signal(signal.SIGINT)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.5)
    process.send_signal(signal.SIGTERM)
    assert end_of(process) == (130, "tiler: interrupted")


@pytest.mark.processes
@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["run"], "Missing argument 'INPUT...'; see `tiler run --help`"),
        (["run", "a.laz"], "Missing option '-o' / '--out'; see `tiler run --help`"),
        (["plan", "a.laz", "--hallo"], "there is no option --hallo; did you mean --halo"),
        (
            ["plan", "a.laz", "--sheet", "1"],
            "--sheet is the beginning of --sheets and --sheet-field and --sheet-name; write",
        ),
        (
            ["plan", "a.laz", "--co", "zstd"],
            "--co is an option of another program; here the comp",
        ),
        (
            ["plan", "a.laz", "--tile_size", "9"],
            "no option --tile_size; did you mean --tile-size?",
        ),
        (["plan", "a.laz", "--zzzz"], "there is no option --zzzz; see `tiler plan --help`"),
        (["plan", "a.laz", "--t_srs", "EPSG:4326"], "`gdalwarp -t_srs EPSG:... OUT/dtm.tif"),
        (
            ["plan", "a.laz", "-step=0.5"],
            "-step is an option of another program; here the side",
        ),
        (
            ["plan", "a.laz", "--memory", "4"],
            "is a memory size of 4 bytes; give a unit, as in 4GB",
        ),
        (["plann"], "No such command 'plann'"),
        (["plan", "a.laz", "--workers", "two"], "Invalid value for '--workers'"),
        (["plan", "a.laz", "--compress", "zip"], "Invalid value for '--compress'"),
        (["plan", "a.laz", "--bounds", "1", "2", "3"], "--bounds"),
        (["plan", "a.laz", "--workers", "0"], "workers 0: must be a whole number above 0"),
        (["plan", "a.laz", "--resolution", "-1"], "-1"),
        (["plan", "a.laz", "--resolution", "1furlong"], "unknown unit 'furlong'"),
        (["plan", "a.laz", "--memory", "lots"], "'lots' is not a memory size"),
        (["plan", "a.laz", "--set", "rounds"], "--set rounds is not valid; give name=value"),
        (["plan", "a.laz", "--keep-classes", "7,300"], "classes out of range; give 0 to 255"),
        (["plan", "a.laz", "--bounds", "5", "0", "1", "1"], "X0 must be below X1"),
        (["plan", "a.laz", "--config", "/nowhere/x.toml"], "x.toml: No such file"),
        (["methods", "best"], "no method 'best'"),
        (["config", "--set", "colour=red"], "no parameter 'colour'"),
    ],
)
def test_usage_errors_are_one_line_and_2(
    arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("tiler: error: ")
    assert captured.err.count("\n") == 1
    assert text in captured.err
    assert captured.out == ""


@pytest.mark.parametrize(
    ("given", "settings"),
    [
        (["--reso=2", "--res", "3"], {"resolution": "3"}),
        (["--overw", "--skip-ov"], {"overwrite": True, "skip_overlap": True}),
        (["--breakl", "--res", "--breakl", "b"], {"breaklines": ("--res", "b")}),
        (["--out", "--res"], {"out": "--res"}),
        (["--", "--res"], {"inputs": ("a.laz", "--res")}),
    ],
)
def test_the_beginning_of_one_option_is_this_option(
    given: list[str], settings: dict[str, Any]
) -> None:
    context = run.make_context("run", ["a.laz", "-o", "o", *given])
    assert {name: context.params[name] for name in settings} == settings


@pytest.mark.processes
@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "--progress", "json", "--nosuch"],
        ["run", "--nosuch", "--progress=json"],
        ["run", "a.laz", "--progress", "json", "-o"],
        ["run", "a.laz", "-o", "out", "--workers", "two", "--progress", "json"],
        ["plann", "--progress", "json"],
    ],
)
def test_usage_errors_are_one_object_where_progress_is_json(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    told = json.loads(line)
    assert told["level"] == "error"
    assert told["message"].startswith("tiler: error: ")


@pytest.mark.parametrize(
    "arguments", [["run", "--nosuch", "--", "--progress", "json"], ["run", "--nosuch"]]
)
def test_they_are_plain_where_it_is_not(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert capsys.readouterr().err.startswith("tiler: error: there is no option --nosuch")


@pytest.mark.parametrize("is_json", [False, True])
def test_an_option_given_twice_is_a_warning(
    is_json: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """Options that may be repeated are none."""
    given = ["--resolution", "1", "--set", "rounds=3", "--set", "low_group=3", "-v", "-v"]
    progress = ["--progress", "json"] if is_json else ["--progress", "none"]
    assert main(["run", "/nowhere.laz", "-o", "o", *progress, *given, "--resolution=2"]) != 0
    first = capsys.readouterr().err.splitlines()[0]
    if is_json:
        told = json.loads(first)
        assert told["level"] == "warning"
        first = told["message"]
    assert first == "warning: --resolution is given more than once; the last value counts"


def test_the_remedies_for_options_of_other_programs_exist() -> None:
    own = {name for p in run.params for name in (*p.opts, *p.secondary_opts)}
    for text in OTHER_PROGRAMS.values():
        assert options_in(text) <= own


@pytest.mark.parametrize("option", ["--epsg", "--bbox", "--buffer"])
def test_a_command_does_not_name_options_that_it_does_not_have(
    capsys: pytest.CaptureFixture[str], option: str
) -> None:
    own = {name for p in check.params for name in (*p.opts, *p.secondary_opts)}
    assert main(["check", option, "1", "a.laz"]) == 2
    error = capsys.readouterr().err
    assert f"there is no option {option}" in error
    assert options_in(error) <= own | {option, "--help"}


def test_without_a_command_help_and_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("Usage: tiler")


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    from tiler.version import __version__

    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"tiler, version {__version__}\n"


def test_help_lists_every_command_with_the_line_of_its_own_help(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["--help"]) == 0
    shown = capsys.readouterr().out
    modules = {p.stem for p in (ROOT / "cli" / "commands").glob("*.py")} - {"__init__"}
    assert modules | set(STAGES) == set(COMMANDS)
    for name, line in COMMANDS.items():
        assert f"  {name} " in shown
        assert line in shown
        command = group.get_command(click.Context(group), name)
        assert command is not None
        assert command.name == name
        assert (command.help or "").strip().splitlines()[0] == line


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_says_its_default(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name, "--help"]) == 0
    assert f"Usage: tiler {name}" in capsys.readouterr().out
    assert isinstance(group, LazyGroup)
    command = group.get_command(click.Context(group), name)
    assert command is not None
    for option in (p for p in command.params if isinstance(p, click.Option)):
        assert option.required or "default" in (option.help or ""), (
            f"{option.opts[0]}: no default told"
        )


@pytest.mark.parametrize("name", ["run", "plan", "preview", "grid"])
def test_help_has_the_frequent_options_in_groups_and_help_all_has_every_option(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert isinstance(group, LazyGroup)
    command = group.get_command(click.Context(group), name)
    assert command is not None
    options = {o for p in command.params if isinstance(p, click.Option) for o in p.opts}
    assert main([name, "--help"]) == 0
    short = capsys.readouterr().out
    assert len(short.splitlines()) <= 60
    assert main([name, "--help-all"]) == 0
    whole = capsys.readouterr().out
    for shown in (short, whole):
        titles = [
            line[:-1] for line in shown.splitlines() if re.fullmatch("[A-Z][a-z]+:", line)
        ]
        assert titles == [title for title in (OWN, *GROUPS) if title in titles]
    assert {o for o in options if not re.search(rf"{o}\b", whole)} == set()
    assert f"`tiler {name} --help-all`" in short
    assert "--out" in short
    assert "--crs " in short


def test_each_setting_has_one_group_and_each_row_an_option() -> None:
    rows = [option for options in GROUPS.values() for option in options]
    assert len(rows) == len(set(rows))
    command = group.get_command(click.Context(group), "run")
    assert command is not None
    options = {p.opts[-1] for p in command.params if isinstance(p, click.Option)}
    assert set(rows) == options | {"--help"}


@pytest.mark.processes
def test_help_imports_nothing_heavy() -> None:
    """That is what makes it quick."""
    script = (
        "import sys\n"
        "from cli.main import main\n"
        "try:\n"
        "    main(sys.argv[1:])\n"
        "finally:\n"
        "    heavy = {'numpy', 'numba', 'scipy', 'distributed', 'zarr', 'rasterio', 'laspy', 'rich', 'pyproj'}\n"
        "    print(sorted(heavy & set(sys.modules)), file=sys.stderr)\n"
    )
    for arguments in (["--help"], ["run", "--help"], ["--version"]):
        done = subprocess.run(
            [sys.executable, "-c", script, *arguments],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stderr.strip() == "[]"


@pytest.mark.processes
def test_only_a_run_imports_dask() -> None:
    script = "import sys, tiler.apps.classify, tiler.apps.info, tiler.pipeline; print('distributed' in sys.modules)"
    assert (
        subprocess.check_output([sys.executable, "-c", script], cwd=ROOT, text=True).strip()
        == "False"
    )


def test_a_closed_output_is_no_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdout", None)
    assert main(["methods", "classic"]) == 0
