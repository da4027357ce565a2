"""Compilation before a run starts."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import ptd
from ptd import api, precompile
from ptd.methods import METHODS
from ptd.passes import KINDS
from ptd.precompile import filters_name, warm_filters, warm_gridding


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the marks; the machine code stays in its place."""
    monkeypatch.setattr(precompile, "cache_folder", lambda: tmp_path)
    return tmp_path


@pytest.mark.parametrize("method", METHODS)
def test_every_method_gets_through_the_scene(method: str, folder: Path) -> None:
    """A refusal would leave the kernels of later passes to the workers."""
    told: list[str] = []
    for _ in range(2):
        warm_filters(method, lambda: told.append(method))
    names = {filters_name(method, kind) for kind in KINDS}
    assert len(told) == len(names)
    assert {path.name for path in folder.iterdir()} == {f"{name}.compiled" for name in names}


@pytest.mark.parametrize("kind", KINDS)
def test_the_scene_is_recognised_as_the_requested_kind(
    kind: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise the passes of the other kind would be compiled."""
    done: list[dict[str, Any]] = []
    real = api.do_passes
    monkeypatch.setattr(api, "do_passes", lambda *given: done.append(real(*given)[1]))
    for method in METHODS:
        if precompile.has_kinds(method):
            warm_filters(method, lambda: None, kind)
    assert {state["survey"]["kind"] for state in done} == {kind}


LAST_PASS = """
from pathlib import Path
from ptd import precompile
from ptd.ground import fine_planes, fine_surface, labelling

modules = fine_planes, fine_surface, labelling
named = {f"{m.__name__}.{n}": k for m in modules for n, k in vars(m).items() if hasattr(k, "signatures")}
precompile.warm_last_pass()
first = {name: len(kernel.signatures) for name, kernel in named.items() if kernel.signatures}
precompile.cache_folder = lambda: Path(".")
precompile.warm_filters("auto", lambda: None, "lidar")
print(len(first), [name for name, n in first.items() if len(named[name].signatures) != n])
"""


@pytest.mark.processes
def test_all_passes_use_the_kernels_of_the_last_pass_as_it_is_compiled_alone(
    tmp_path: Path,
) -> None:
    environment = {**os.environ, "PYTHONPATH": str(Path(ptd.__file__).parents[1])}
    told = subprocess.run(
        [sys.executable, "-c", LAST_PASS],
        cwd=tmp_path,
        env=environment,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    number, _, others = told.strip().partition(" ")
    assert int(number) > 10
    assert others == "[]"


@pytest.mark.parametrize("interpolation", ["linear", "natural"])
def test_gridding(interpolation: str, folder: Path) -> None:
    told: list[str] = []
    for _ in range(2):
        warm_gridding(interpolation, lambda: told.append(interpolation))
    assert told == [interpolation]


def test_without_a_folder_nothing_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(precompile, "cache_folder", lambda: None)
    monkeypatch.setattr(precompile, "_scene", lambda: pytest.fail("compiled for nothing"))
    told: list[str] = []
    warm_filters("classic", lambda: told.append("each process compiles for itself"))
    assert told


@pytest.mark.processes
def test_another_installation_has_a_folder_of_its_own(tmp_path: Path) -> None:
    """numba keeps code by the location of its source, so installations do not share it."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": ""}
    folders = set()
    for place in (tmp_path / "one", tmp_path / "twin"):
        shutil.copytree(
            Path(ptd.__file__).parent,
            place / "ptd",
            ignore=shutil.ignore_patterns("__pycache__"),
        )
        told = [
            sys.executable,
            "-c",
            "from ptd.kernel import cache_folder; print(cache_folder())",
        ]
        folders.add(
            subprocess.run(
                told, cwd=place, env=environment, check=True, capture_output=True
            ).stdout
        )
    assert len(folders) == 2


def test_a_run_that_compiles_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "tiler-kernels" / "mine"
    folder.mkdir(parents=True)
    monkeypatch.setattr(precompile, "cache_folder", lambda: folder)
    assert "the first run that keeps its machine code" in precompile.why_not_compiled(
        "auto-dim"
    )
    (folder.parent / "other").mkdir()
    assert "another version or installation" in precompile.why_not_compiled("auto-dim")
    (folder / "auto-lidar.compiled").touch()
    assert "those of auto-dim have not been compiled" in precompile.why_not_compiled("auto-dim")
    monkeypatch.setattr(precompile, "cache_folder", lambda: None)
    assert "each process compiles" in precompile.why_not_compiled("auto-dim")
