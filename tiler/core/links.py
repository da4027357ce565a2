"""Symbolic links, through which nothing is written.

Other users who can write to a folder can make links in it. A write through such a link would
change the file to which it leads, with the rights of the user who runs tiler.
"""

from __future__ import annotations

import os
from pathlib import Path

from tiler.errors import ConfigError


def link_error(path: Path, option: str = "") -> ConfigError:
    """Return the error for a link through which a command would write."""
    return ConfigError(
        f"{option} {path} is a link, through which tiler does not write; remove the link and run again".strip()
    )


def without_links(path: str, flags: int) -> int:
    """Open a file, but not through a link with its name (an ``opener`` of `open`). Raise OSError for a link."""
    # Windows has no such flag. Its users need a privilege to make links.
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)
