"""Make the pictures of ``gallery.md`` by the commands of that page: ``python docs/gallery.py``, or building the site.

The commands run block by block in an empty folder. The pictures that the page shows are then copied to
``docs/gallery/``.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

HERE = Path(__file__).resolve().parent
BLOCK = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PICTURE = re.compile(r"\]\(gallery/([\w-]+\.png)\)")


def make_pictures(docs: Path) -> None:
    """Make the pictures of the page below ``docs``, unless all of them are there and newer than the page."""
    source = docs / "gallery.md"
    page = source.read_text("utf-8")
    names = PICTURE.findall(page)
    target = docs / "gallery"
    if all(_is_newer(target / name, source) for name in names):
        return
    target.mkdir(exist_ok=True)
    # The programs of this Python's environment come first: `tiler`, and `rio` of rasterio.
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    with TemporaryDirectory() as folder:
        for commands in BLOCK.findall(page):
            subprocess.run(
                ["bash", "-euo", "pipefail", "-c", commands],
                cwd=folder,
                env={**os.environ, "PATH": path},
                check=True,
            )
        for name in names:
            # Two builds at the same time make the same pictures; each appears when it is whole.
            part = target / f"{name}.{os.getpid()}"
            shutil.copy(Path(folder) / name, part)
            part.replace(target / name)


def _is_newer(picture: Path, source: Path) -> bool:
    return picture.exists() and picture.stat().st_mtime >= source.stat().st_mtime


if __name__ == "__main__":
    make_pictures(HERE)
