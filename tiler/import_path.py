"""Import path without untrusted folders: the current folder, which may contain data, and Dask's scratch."""

import os
import sys

# Nothing else is imported here, since it could come from one of the untrusted folders.

_HOME = os.path.realpath(os.path.join(os.path.dirname(__file__), os.pardir))
"""Folder from which tiler itself was imported."""

_SCRATCH = "dask-scratch-space"
"""Prefix of the names of Dask's scratch folders, which by default are in a folder that all
users share."""


def without_scratch(entries: list[str]) -> list[str]:
    """Return the entries of an import path that are not in a scratch folder of Dask."""
    return [entry for entry in entries if f"{os.sep}{_SCRATCH}" not in entry]


def trusted_path() -> list[str]:
    """Return the entries of `sys.path` without Dask's folders and without the current folder.

    The current folder stays if tiler itself is in it. A ``laspy.py`` in a folder of clouds must not be executed, and a
    ``random.py`` of the user must not replace Python's own. Python puts the current folder first for ``python -m`` and
    ``python -c``, and for each empty entry of ``PYTHONPATH``.
    """
    entries = without_scratch(sys.path)
    try:
        here = os.getcwd()
    # The current folder was removed, so nothing can be imported from it.
    except FileNotFoundError:
        return [entry for entry in entries if os.path.isabs(entry)]
    real = os.path.realpath(here)
    found = [os.path.join(here, entry) for entry in entries if entry]
    return [entry for entry in found if os.path.realpath(entry) != real or real == _HOME]
