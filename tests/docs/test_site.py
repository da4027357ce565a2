"""The site: it is built without a warning, loads nothing from elsewhere, and holds every page and every public name."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import ptd
import tiler
from tests.docs.test_docs import MAX_PICTURE, PAGES, ROOT
from tests.integration.command import environment
from tests.waiting import PATIENCE_SECONDS

pytest.importorskip("sphinx", reason="the site needs the extra `docs`")

pytestmark = [pytest.mark.slow, pytest.mark.processes]

LOADED = re.compile(
    r'<(?:script|img|iframe|source|link)\b[^>]*\b(?:src|href)="((?:https?:)?//[^"]*)"'
)
LOADED_BY_STYLE = re.compile(r"(?:url\(|@import)\s*[\"']?((?:https?:)?//[^\"')]*)")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site that `.ci/run` built, else one built from a copy of the pages and pictures; a warning is an error."""
    if built := os.environ.get("CI_SITE"):
        return Path(built)
    folder = tmp_path_factory.mktemp("site")
    pages, out = folder / "docs", folder / "out"
    shutil.copytree(ROOT / "docs", pages)
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", str(pages), str(out)],
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_SECONDS,
    )
    assert done.returncode == 0, done.stderr
    return out


def test_every_page_is_in_the_navigation(site: Path) -> None:
    index = (site / "index.html").read_text("utf-8")
    for page in PAGES:
        if page.stem not in ("README", "index"):
            assert f'class="reference internal" href="{page.stem}.html"' in index, page.name


def test_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    for path in site.rglob("*.html"):
        assert not LOADED.findall(path.read_text("utf-8")), path
    for path in site.rglob("*.css"):
        assert not LOADED_BY_STYLE.findall(path.read_text("utf-8")), path


def test_every_public_name_is_in_the_reference(site: Path) -> None:
    for package in (tiler, ptd):
        text = (site / f"api-{package.__name__}.html").read_text("utf-8")
        for name in package.__all__:
            if not name.startswith("__"):
                assert f'id="{package.__name__}.{name}"' in text, name


def test_the_search_finds_words_of_the_pages(site: Path) -> None:
    index = (site / "searchindex.js").read_text("utf-8")
    for word in ("hillshad", "halo", "lastool", "geotiff"):  # stems, as the index has them
        assert word in index


def test_pictures_of_the_gallery_are_made_and_small(site: Path) -> None:
    names = re.findall(r"gallery/([\w-]+\.png)", (ROOT / "docs/gallery.md").read_text("utf-8"))
    assert names
    for name in names:
        picture = site / "_images" / name
        assert 10_000 < picture.stat().st_size < MAX_PICTURE, name
