"""The documentation: what is generated is current, links lead somewhere, every command works."""

from __future__ import annotations

import contextlib
import os
import random
import re
import shlex
import socket
import subprocess
import sys
from itertools import groupby
from pathlib import Path

import pytest

from tests.integration.command import environment

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs").glob("*.md"))
BLOCK = re.compile(r"^```(sh|python)(?: exit=(\d+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)#:]+)(?:#[^)]*)?\)")
LARGEST_PICTURE = 200_000
PORT = "8786"


def free_port() -> str:
    """One below those that systems give away by themselves, as the blocks before may take minutes."""
    for port in random.sample(range(20_000, 32_000), 100):
        with socket.socket() as free, contextlib.suppress(OSError):
            free.bind(("127.0.0.1", port))
            return str(port)
    raise AssertionError("no free port")


def blocks(page: Path) -> list[tuple[int, str]]:
    """Exit code and commands of each block; blocks of Python that follow one another are one script.

    Those that are marked with anything else, as ``on-a-cluster``, are left out.
    """
    found: list[tuple[int, str]] = []
    for language, made in groupby(BLOCK.findall(page.read_text("utf-8")), key=lambda block: block[0]):
        if language == "python":
            script = "".join(text for _, _, text in made)
            found.append((0, f"{shlex.quote(sys.executable)} - <<'END OF PAGE'\n{script}END OF PAGE\n"))
        else:
            found += [(int(code or 0), text) for _, code, text in made]
    return found


def test_parameters_are_those_of_the_source() -> None:
    made = subprocess.run(
        [sys.executable, "-c", "import reference, sys; sys.stdout.write(reference.page())"],
        cwd=ROOT / "docs",
        env=environment(),
        capture_output=True,
        text=True,
        check=True,
    )
    assert (ROOT / "docs/parameters.md").read_text("utf-8") == made.stdout, "run `python docs/reference.py`"


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path) -> None:
    for link in LINK.findall(page.read_text("utf-8")):
        assert (page.parent / link).exists(), link


def test_every_page_is_linked() -> None:
    linked = {link for page in PAGES for link in LINK.findall(page.read_text("utf-8"))}
    assert {p.name for p in PAGES} - {"README.md"} <= linked


@pytest.mark.parametrize("picture", sorted((ROOT / "docs").glob("*.png")), ids=lambda p: p.name)
def test_pictures_are_small_and_shown(picture: Path) -> None:
    assert picture.stat().st_size < LARGEST_PICTURE
    texts = [(ROOT / "README.md").read_text("utf-8"), *(p.read_text("utf-8") for p in PAGES)]
    assert any(picture.name in text for text in texts)


@pytest.mark.slow
@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p)], ids=lambda p: p.stem)
def test_every_command_works(page: Path, tmp_path: Path) -> None:
    """In an empty folder, block by block, as a reader would."""
    programs, folder = tmp_path / "bin", tmp_path / "folder"
    programs.mkdir()
    folder.mkdir()
    for name, module in (("tiler", "cli.main"), ("dask", "dask.__main__")):
        program = programs / name
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m {module} "$@"\n')
        program.chmod(0o755)
    path = os.pathsep.join((str(programs), os.environ["PATH"]))
    port = free_port()
    for code, text in blocks(page):
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", text.replace(PORT, port)],
            cwd=folder,
            env={**environment(), "PATH": path, "QGIS_CUSTOM_CONFIG_PATH": str(tmp_path / "qgis")},
            capture_output=True,
            text=True,
            check=False,
            timeout=900,
        )
        assert done.returncode == code, f"{text}\n{done.stdout}\n{done.stderr}"
