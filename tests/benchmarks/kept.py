"""Results in a folder, each by a digest of what it follows from: an interrupted benchmark goes on where it was."""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
REGISTRIES = {
    ROOT / "ptd/__init__.py",
    ROOT / "ptd/methods/__init__.py",
    ROOT / "tiler/__init__.py",
}
"""Import every method: followed, each method would change with any other."""


class Kept:
    """Values by key, as JSON files of a folder; without a folder nothing is kept."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder

    def __call__(self, key: str, make: Callable[[], Any]) -> Any:
        """The value kept under a key; it is made, and kept, where there is none."""
        if self._folder is None:
            return make()
        path = self._folder / f"{key}.json"
        if path.is_file():
            return json.loads(path.read_text(encoding="utf-8"))
        value = make()
        self._folder.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        part.write_text(json.dumps(value), encoding="utf-8")
        part.replace(path)
        return value


def digest(*parts: str) -> str:
    """A key of texts, in their order."""
    return hashlib.blake2b("\0".join(parts).encode(), digest_size=16).hexdigest()


@cache
def digest_of_file(path: Path) -> str:
    """A key of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "md5").hexdigest()


@cache
def digest_of_modules(*names: str) -> str:
    """A key of the sources of modules, of all that they import of this project, and of the data beside them."""
    sources = sources_of(*names)
    data = {path.with_suffix(".npz") for path in sources}
    files = sorted(sources | {path for path in data if path.is_file()})
    return digest(*(f"{path.relative_to(ROOT)} {digest_of_file(path)}" for path in files))


def sources_of(*names: str) -> set[Path]:
    """Files of modules and of all modules of this project that they import, directly or not."""
    todo, seen = [path for name in names for path in _files(name)], set[Path]()
    while todo:
        path = todo.pop()
        if path not in seen:
            seen.add(path)
            todo += _imports(path)
    return seen


@cache
def _imports(path: Path) -> list[Path]:
    """Files that a module imports; of ``from a import b`` both ``a`` and ``a.b``, as b may be a module."""
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return [found for name in names for found in _files(name)]


def _files(name: str) -> list[Path]:
    """Where a module of this project lies; nothing of others."""
    base = ROOT.joinpath(*name.split("."))
    return [
        p
        for p in (base.with_suffix(".py"), base / "__init__.py")
        if p.is_file() and p not in REGISTRIES
    ]
