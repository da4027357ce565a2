"""What the fork server holds ready: everything imported, the kernels in memory, buckets as small as in the fixtures.

Opens no store: zarr's thread would be missing in the processes that are forked off.
"""

from __future__ import annotations

import numpy as np

import tiler.plan.sizes
import tiler.schedule.workers
from ptd import classify
from tests.invariants import runs  # noqa: F401

tiler.plan.sizes.BUCKET_POINTS = 1000
x, y = (axis.ravel() for axis in np.meshgrid(np.arange(60.0), np.arange(60.0)))
classify(np.stack([x, y, np.sin(x / 9)], axis=1))
