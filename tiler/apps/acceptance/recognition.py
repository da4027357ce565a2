"""Recognition of clouds among the arguments of ``tiler check``, which may also be a DTM or the results of a run."""

from __future__ import annotations

import glob
import os
from collections.abc import Sequence
from pathlib import Path

from tiler.errors import ConfigError
from tiler.inputs import is_list
from tiler.io.cloud_formats import FORMAT_NAMES, SUFFIXES
from tiler.io.locations import is_url, without_query
from tiler.io.result_folder import give_results, is_results, resolution_folders


def are_clouds(paths: Sequence[str]) -> bool:
    """Return whether all paths are clouds, lists, globs or folders of clouds.

    Raise ConfigError if only some of them are, or if there are several that are none.
    """
    others = [path for path in paths if not _is_cloud(path)]
    if not others:
        return bool(paths)
    if len(paths) > 1:
        raise ConfigError(
            f"{others[0]}: is not a cloud; give one DTM, one OUT folder, or only {FORMAT_NAMES} clouds"
        )
    return False


def _is_cloud(text: str) -> bool:
    if is_list(text) or Path(without_query(text)).suffix.lower() in SUFFIXES:
        return True
    if is_url(text):
        return False
    if os.path.isdir(text):
        if is_results(text):
            return False
        if resolution_folders(text):
            raise ConfigError(f"{text}: has no results of a run; {give_results(text)}")
        return _has_clouds(Path(text))
    if glob.has_magic(text) and not os.path.lexists(text):
        return any(_is_cloud(match) for match in glob.iglob(text, recursive=True))
    return False


def _has_clouds(folder: Path) -> bool:
    return any(
        Path(name).suffix.lower() in SUFFIXES
        for _, _, names in os.walk(folder)
        for name in names
    )
