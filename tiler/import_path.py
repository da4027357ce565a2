"""Keeps the current folder out of the import path, as data folders may hold Python files."""

import os
import sys

# Nothing else is imported here: it could come from the very folder that is to be left out.

_HOME = os.path.realpath(os.path.join(os.path.dirname(__file__), os.pardir))
"""The folder that tiler itself was imported from."""


def trusted_path() -> list[str]:
    """The entries of `sys.path` without the current folder, unless tiler itself lies there.

    Clouds are delivered in folders: a ``laspy.py`` beside them must not be executed, and a ``random.py`` of the user's
    own must not stand in for Python's. Python puts that folder first for ``python -m`` and ``python -c``, and for each
    empty entry of ``PYTHONPATH``.
    """
    try:
        here = os.getcwd()
    except FileNotFoundError:  # it was removed: nothing can be imported from there
        return [entry for entry in sys.path if os.path.isabs(entry)]
    real = os.path.realpath(here)
    found = [os.path.join(here, entry) for entry in sys.path if entry]
    return [entry for entry in found if os.path.realpath(entry) != real or real == _HOME]
