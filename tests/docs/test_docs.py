"""The documentation: what is generated is current, links lead somewhere, every command works."""

from __future__ import annotations

import contextlib
import os
import random
import re
import shlex
import shutil
import socket
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import pytest

from ptd.methods import METHODS
from tests.docs.resident import write_client
from tests.integration.command import environment
from tests.waiting import PATIENCE_SECONDS, wait_until
from tiler.core.products import PRODUCTS

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs").glob("*.md"))
BLOCK = re.compile(r"^```(\w*)(?: ([^\n]*))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"^ {4}(tiler|python|pip|dask) ", re.MULTILINE)
NOT_RUN = re.compile(r"# .+: not run by the tests\n")
NEEDS = re.compile(r"# needs (.+)\n")
LINK = re.compile(r"\]\(([^)#:]+)(?:#[^)]*)?\)")
MAX_PICTURE = 200_000
PORT = "8786"
BACKGROUND = re.compile(r" & \w+=\$!$", re.MULTILINE)
"""A command that is left to itself, to be killed later, or to serve as a cluster."""
PROGRAMS = {"tiler": "cli.main", "dask": "dask.__main__", "rio": "rasterio.rio.main"}
"""Programs of the pages and the modules that are theirs."""


def free_port() -> str:
    """One below those that systems give away by themselves, as the blocks before may take minutes."""
    for port in random.sample(range(20_000, 32_000), 100):
        with socket.socket() as free, contextlib.suppress(OSError):
            free.bind(("127.0.0.1", port))
            return str(port)
    raise AssertionError("no free port")


def blocks(page: Path) -> list[tuple[int, str]]:
    """Exit code and commands of each block that runs here; blocks of Python that follow one another are one script.

    A block says in its first line, for the reader as well, that it is not run, or which
    programs it needs.
    """
    runs = []
    for language, mark, text in BLOCK.findall(page.read_text("utf-8")):
        if language in ("sh", "python") and mark != "on-a-cluster" and runs_here(text):
            runs.append((language, int(mark.removeprefix("exit=") or 0), text))
    found: list[tuple[int, str]] = []
    for language, made in groupby(runs, key=lambda block: block[0]):
        if language == "python":
            script = "".join(text for _, _, text in made)
            found.append(
                (0, f"{shlex.quote(sys.executable)} - <<'END OF PAGE'\n{script}END OF PAGE\n")
            )
        else:
            found += [(code, text) for _, code, text in made]
    return found


def runs_here(text: str) -> bool:
    needed = NEEDS.match(text)
    programs = needed[1].split(", ") if needed else []
    return not NOT_RUN.match(text) and all(shutil.which(program) for program in programs)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_every_block_is_run_or_says_why_not(page: Path) -> None:
    text = page.read_text("utf-8")
    assert not INDENTED.search(text), "commands stand in a block with ```sh"
    for language, mark, block in BLOCK.findall(text):
        if language in ("sh", "python"):
            assert re.fullmatch(r"(exit=\d+|on-a-cluster)?", mark), f"unknown mark {mark!r}"
        elif language == "toml":
            tomllib.loads(block)
        elif language == "r":
            assert NOT_RUN.match(block), block
        else:
            assert language == "text" or page.name == "index.md", (
                f"a block of the language {language!r}"
            )


@pytest.mark.processes
def test_parameters_are_those_of_the_source() -> None:
    made = subprocess.run(
        [sys.executable, "-c", "import reference, sys; sys.stdout.write(reference.page())"],
        cwd=ROOT / "docs",
        env=environment(),
        capture_output=True,
        text=True,
        check=True,
    )
    assert (ROOT / "docs/parameters.md").read_text("utf-8") == made.stdout, (
        "run `python docs/reference.py`"
    )


@pytest.mark.parametrize("name", METHODS)
def test_both_pages_on_methods_have_all(name: str) -> None:
    """A section for developers, and a line for users."""
    sections = re.findall(r"^##? `(\w+)`", (ROOT / "docs/filters.md").read_text("utf-8"), re.M)
    assert name in sections, "add a section to docs/filters.md"
    lines = re.findall(r"^- `(\w+)`: ", (ROOT / "docs/methods.md").read_text("utf-8"), re.M)
    assert name in lines, "add a line to docs/methods.md"


def test_the_table_of_products_has_all() -> None:
    page = (ROOT / "docs/first-dtm.md").read_text("utf-8")
    rows = re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)
    assert [name for name in rows if name in PRODUCTS] == list(PRODUCTS)


@pytest.mark.parametrize("name", ["CONTRIBUTING.md", "SECURITY.md"])
def test_tests_that_hold_promises_exist(name: str) -> None:
    paths = re.findall(r"`(tests/[\w/.]+)`", (ROOT / name).read_text("utf-8"))
    assert len(paths) > 20
    assert [path for path in paths if not (ROOT / path).exists()] == []


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path) -> None:
    for link in LINK.findall(page.read_text("utf-8")):
        if not link.startswith("gallery/"):  # made when the site is built
            assert (page.parent / link).exists(), link


def test_the_page_on_trust_is_short() -> None:
    """It is read before a delivery is used, so it has to be read to its end."""
    assert len((ROOT / "docs/trust.md").read_text("utf-8").split()) <= 500


def test_every_page_is_linked() -> None:
    linked = {link for page in PAGES for link in LINK.findall(page.read_text("utf-8"))}
    assert {p.name for p in PAGES} - {"README.md", "index.md"} <= linked


@pytest.mark.parametrize("picture", sorted((ROOT / "docs").glob("*.png")), ids=lambda p: p.name)
def test_pictures_are_small_and_shown(picture: Path) -> None:
    assert picture.stat().st_size < MAX_PICTURE
    texts = [(ROOT / "README.md").read_text("utf-8"), *(p.read_text("utf-8") for p in PAGES)]
    assert any(picture.name in text for text in texts)


@pytest.fixture(scope="module")
def warm_tiler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A program `tiler` whose commands are forks of a warm process; starting them takes most of the time of a page."""
    program = tmp_path_factory.mktemp("warm") / "tiler"
    # an address of a socket has 107 bytes at most
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        address = Path(folder) / "socket"
        call = [sys.executable, "-m", "tests.docs.resident", str(address)]
        with subprocess.Popen(
            call, cwd=ROOT, env=environment(), stdin=subprocess.PIPE
        ) as server:
            wait_until(address.exists, server)
            write_client(program, address)
            yield program
            server.communicate()


@pytest.mark.processes
@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [p for p in PAGES if blocks(p) and p.stem != "gallery"], ids=lambda p: p.stem
)
def test_every_command_works(page: Path, warm_tiler: Path, tmp_path: Path) -> None:
    """In an empty folder, block by block, as a reader would. Building the site runs the commands of the gallery."""
    run_blocks(blocks(page), tmp_path, warm_tiler)


@pytest.mark.processes
@pytest.mark.slow
def test_the_commands_of_the_readme_work(warm_tiler: Path, tmp_path: Path) -> None:
    """.ci/run runs the blocks that install, docker/smoke.sh the steps of the image."""
    prepared = """
        mkdir clouds
        tiler simulate clouds/a.laz --size 80 --seed 1
        printf 'name,x,y,z,type\\n1,500040,5400040,118,NVA\\n' > checkpoints.csv
    """
    readme = [
        b
        for b in blocks(ROOT / "README.md")
        if "pip install" not in b[1] and "docker" not in b[1]
    ]
    assert readme
    run_blocks([(0, prepared), *readme], tmp_path, warm_tiler)


def run_blocks(found: list[tuple[int, str]], tmp_path: Path, warm_tiler: Path) -> None:
    """Run blocks in an empty folder.

    ``warm_tiler`` is the program `tiler`. In blocks that leave a command in the background, each starts as usual.
    """
    programs, folder = tmp_path / "bin", tmp_path / "folder"
    programs.mkdir()
    folder.mkdir()
    for name, module in PROGRAMS.items():
        program = programs / name
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m {module} "$@"\n')
        program.chmod(0o755)
    usual = [str(programs), os.environ["PATH"]]
    port = free_port()
    for code, text in found:
        path = usual if BACKGROUND.search(text) else [str(warm_tiler.parent), *usual]
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", text.replace(PORT, port)],
            cwd=folder,
            env={
                **environment(),
                "PATH": os.pathsep.join(path),
                "QGIS_CUSTOM_CONFIG_PATH": str(tmp_path / "qgis"),
            },
            capture_output=True,
            text=True,
            check=False,
            timeout=PATIENCE_SECONDS,
        )
        assert done.returncode == code, f"{text}\n{done.stdout}\n{done.stderr}"
