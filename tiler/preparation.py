"""Preparation of the server of forks, which imports the workers' modules while this process imports its own.

The functions contain the imports, since the server calls them by name and importing this module
must be fast.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from tiler.io.locations import is_url, joined
from tiler.io.result_folder import STORE
from tiler.schedule import prepare_children

if TYPE_CHECKING:
    from tiler.config import RunConfig


def import_reading() -> None:
    """Import the modules that inspect clouds."""
    import tiler.inputs.sources


def import_stages() -> None:
    """Import the work of all stages."""
    import tiler.export.stage
    import tiler.filter.stage
    import tiler.grid.stage
    import tiler.ingest.stage


def import_method() -> None:
    """Import the filter that most runs use."""
    import ptd.methods.auto.method


def load_kernels() -> None:
    """Load most of numba."""
    from tiler.schedule.worker import load_kernels

    load_kernels()


def import_libraries() -> None:
    """Import the libraries that tasks import only when they use them."""
    import pyogrio
    import scipy.ndimage
    import scipy.optimize
    import scipy.spatial


def prepare_workers(config: RunConfig, products: str) -> bool:
    """Prepare the workers of a run, unless it has no workers or its store may exist already.

    Parameters
    ----------
    config : RunConfig
    products : str
        Path or URL of the results.

    Returns
    -------
    bool
        Whether workers are prepared.
    """
    store = config.store or joined(products, STORE)
    if config.in_process or is_url(store) or os.path.exists(store):
        return False
    prepare_children(
        import_reading, import_stages, import_method, load_kernels, import_libraries
    )
    return True
