"""Checksum of the pixels of a block, which is part of the digests of everything made from it."""

from __future__ import annotations

import hashlib

import numpy as np
import numpy.typing as npt


def checksum(values: npt.NDArray[np.float32]) -> str:
    """Return the BLAKE2b of the pixels, row by row. A task that reads the block depends on it."""
    return hashlib.blake2b(values.tobytes(), digest_size=16).hexdigest()
