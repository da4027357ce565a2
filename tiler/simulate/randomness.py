"""Random numbers that depend only on a seed, a purpose and a position, not on earlier draws."""

from __future__ import annotations

import numpy as np

from ptd.arrays import Float64, Int64, UInt64

BLOCKS, PULSES, MATCHES, BLUNDERS, BIAS, RELIEF, COLOUR, TEXTURE = range(8)
"""Purposes of random numbers. Different purposes give different numbers."""

LATE, CLUMPS, MIRRORS = range(8, 11)
"""Further purposes, for `generator` only. `node_normals` distinguishes eight."""

OFFSET = 1 << 31


def generator(seed: int, purpose: int, *place: int) -> np.random.Generator:
    """Return a generator for lattice indices (also negative), from a hash of the arguments."""
    return np.random.Generator(
        np.random.PCG64([seed, purpose, *(index + OFFSET for index in place)])
    )


def smooth_noise(seed: int, purpose: int, x: Float64, y: Float64, cell_m: float) -> Float64:
    """Return spatially correlated noise, about standard normal at each position.

    Nearly normal numbers are hashed from the nodes of a lattice at coordinate 0, interpolated
    bilinearly, and divided by the root of the sum of the squared weights. So the variance is 1
    everywhere.

    Parameters
    ----------
    seed, purpose : int
    x, y : float64, shape (n,) or broadcastable, metres
    cell_m : float
        Side of a lattice cell in metres, about the distance beyond which the noise is independent.

    Returns
    -------
    float64, broadcast shape
    """
    u, v = np.broadcast_arrays(x / cell_m, y / cell_m)
    column, row = np.floor(u), np.floor(v)
    u, v = u - column, v - row
    column, row = column.astype(np.int64), row.astype(np.int64)
    total = np.zeros(u.shape)
    for east, wx in ((0, 1.0 - u), (1, u)):
        for north, wy in ((0, 1.0 - v), (1, v)):
            total += wx * wy * node_normals(seed, purpose, column + east, row + north)
    return np.asarray(total / np.sqrt((u**2 + (1.0 - u) ** 2) * (v**2 + (1.0 - v) ** 2)))


def node_normals(seed: int, purpose: int, column: Int64, row: Int64) -> Float64:
    """Return nearly normal numbers of mean 0 and variance 1, hashed from lattice indices.

    Each is a sum of four uniform numbers.
    """
    key = np.uint64((seed * 8 + purpose) & 0xFFFFFFFF) << np.uint64(32)
    hashed = _mixed(_mixed(column.astype(np.uint64) ^ key) + row.astype(np.uint64))
    total = np.zeros(hashed.shape)
    for part in range(4):
        total += (hashed >> np.uint64(16 * part)) & np.uint64(0xFFFF)
    return np.asarray((total / 65536.0 - 2.0) * np.sqrt(3.0))


def _mixed(value: UInt64) -> UInt64:
    """Apply the finaliser of SplitMix64 (Steele, Lea & Flood 2014). Overflow is intended."""
    value = value + np.uint64(0x9E3779B97F4A7C15)
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(value ^ (value >> np.uint64(31)))
