"""Files of pages that a command writes beside the user's files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from tiler.core.file_names import link_error
from tiler.errors import ConfigError, write_error
from tiler.io.atomic_files import write_atomic
from tiler.io.overwrite_check import Target, check_targets, is_url_path

HEAD_BYTES = 8192
"""Bytes at the start of a page in which the name of its command stands."""


def validate_page(target: Path, reads: Iterable[str | Path], maker: str) -> None:
    """Raise ConfigError if a page cannot be written, or would replace a file that is not an earlier page.

    Parameters
    ----------
    target : Path
        File that the user gives with ``--page``, or its default.
    reads : iterable of str or Path
        Paths and URLs of all files that the command reads.
    maker : str
        Name of the command, which its pages have in their head (`tiler.report.document.page`).
    """
    if is_url_path(target):
        raise ConfigError(f"--page {target}: is a URL; give a file on this machine")
    check_targets([Target("--page", target, (".html",))], reads)
    if target.is_symlink():
        raise link_error(target, "--page")
    if not target.parent.is_dir():
        raise ConfigError(
            f"--page {target}: its folder does not exist; make it, or give another file"
        )
    if not target.exists():
        return
    try:
        is_earlier = is_page_of(target, maker)
    except OSError as error:
        raise ConfigError(
            f"--page {target}: cannot be read ({error.strerror}); give another file"
        ) from error
    if not is_earlier:
        raise ConfigError(
            f"--page {target}: exists and is not a page of this command; give another file"
        )


def is_page_of(target: Path, maker: str) -> bool:
    """Return whether a file is an earlier page of a command."""
    if not target.is_file():
        return False
    with target.open("rb") as stream:
        return f'content="{maker}"'.encode() in stream.read(HEAD_BYTES)


def write_page(target: Path, content: bytes) -> None:
    """Write a page, or raise ProcessingError."""
    try:
        write_atomic(target, content)
    except OSError as error:
        raise write_error(str(target), error, target.parent) from error
