"""Settings of the site, which ``sphinx-build -W docs site`` makes of the pages of this folder, without a network."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from gallery import make_pictures  # noqa: E402

from tiler import __version__  # noqa: E402

project = "tiler"
version = release = __version__
project_copyright = "the authors of tiler, BSD-3-Clause"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["README.md"]  # index.md shows it

myst_heading_anchors = 3  # links like page.md#a-heading

autodoc_typehints = "none"  # numpydoc docstrings name the types
autodoc_member_order = "bysource"
napoleon_google_docstring = False
default_role = "py:obj"  # `tiler.run` in a docstring is a link where the page of the API has it

smartquotes = False  # `--config` is not an en dash

html_theme = "furo"
html_title = f"tiler {__version__}"
html_copy_source = False
html_show_sphinx = False


def setup(app: Any) -> None:
    """Make the pictures of the gallery before the pages are read."""
    app.connect("builder-inited", lambda app: make_pictures(Path(app.srcdir)))
