"""One file to one file: what is refused before anything is read twice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tiler.classify import classify_file
from tiler.config import RunConfig
from tiler.errors import ConfigError


def test_a_folder_that_cannot_be_made_is_refused(make_cloud: Any, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(ConfigError, match=r"b\.laz: its folder cannot be made \(Not a directory\)"):
        classify_file(
            make_cloud("a.las", n=20), tmp_path / "file" / "sub" / "b.laz", RunConfig(in_process=True)
        )
