"""The command ``tiler``: a thin shell over the library, one file per command."""

import sys

from tiler.import_path import trusted_path

sys.path[:] = trusted_path()  # before anything else is imported
