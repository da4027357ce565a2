"""Other spellings of the path of a folder on Windows, and its links of folders; tests of them skip elsewhere."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest


def spelled(kind: str, path: Path) -> Path:
    """Spell an absolute path as an extended, device or UNC path, or skip the test."""
    if sys.platform != "win32":
        pytest.skip("other systems have one spelling")
    drive, rest = path.drive, str(path)[len(path.drive) :]
    prefixes = {
        "extended path": f"\\\\?\\{drive}",
        "device path": f"\\\\.\\{drive}",
        "UNC path": f"\\\\localhost\\{drive[0]}$",
    }
    found = Path(prefixes[kind] + rest)
    if not found.exists():
        pytest.skip(f"this Windows has no {kind}")
    return found


def junction_or_skip(link: Path, target: Path) -> None:
    """Make a junction, or skip the test."""
    if sys.platform != "win32":
        pytest.skip("other systems have no junctions")
    import _winapi

    try:
        _winapi.CreateJunction(str(target), str(link))
    except OSError as error:
        pytest.skip(f"no junctions: {error.strerror}")
    if not link.is_junction():
        pytest.skip("no junctions: none was made")
