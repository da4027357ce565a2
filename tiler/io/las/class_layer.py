"""Encoder of the layer of the classes in a chunk of LAZ, point formats 6 to 10.

The coordinates, the classes, the flags and other fields of these formats are compressed each into its own layer. So new
classes change one layer, and the others can be copied as they are (`tiler.io.las.writers.ClassWriter`). lazrs only
compresses all layers together.

The coder is the arithmetic coder of A. Said with adaptive models, as LASzip uses it
(https://github.com/LASzip/LASzip, ``arithmeticencoder.cpp``, ``laswriteitemcompressed_v3.cpp``). The bytes are equal to
those of lazrs.
"""

from __future__ import annotations

import numpy as np

from ptd.arrays import Int32, UInt8
from ptd.kernel import as_int64, kernel

Bytes = UInt8

_SYMBOLS = 256
_CHANNELS = 4
_MODELS_OF_CHANNEL = 64
"""Number of models of a scanner channel: one for each lower five bits of the class before, and for points that are, or
are not, the only return of their pulse."""

_PROBABILITY_BITS = 15
"""Bits of a probability. A model's counts add up to at most 2**15."""
_RANGE = 1 << 32
_TOP_BYTE = 1 << 24
"""Length of the interval below which its highest byte is final."""
_FIRST_CYCLE = (_SYMBOLS + 6) >> 1
_LAST_CYCLE = (_SYMBOLS + 6) << 3
"""Number of symbols after which a new model computes its probabilities again, and the largest such number."""
_TOTAL, _CYCLE, _LEFT = 0, 1, 2
"""Columns of the state of a model: sum of its counts, symbols between two computations of the probabilities (0 if the
model has not been used), and symbols left until the next one."""
_MAX_SYMBOL_BYTES = 2
"""Most bytes of a symbol: the lowest probability is 2**-15."""
_END_BYTES = 8


class ClassEncoder:
    """Encoder of class layers. It keeps its arrays from chunk to chunk."""

    def __init__(self) -> None:
        models = _CHANNELS * _MODELS_OF_CHANNEL
        self._counts = np.empty((models, _SYMBOLS), np.int32)
        self._lower = np.empty((models, _SYMBOLS), np.int32)
        self._state = np.empty((models, 3), np.int32)
        self._last = np.empty(_CHANNELS, np.int32)
        self._out = np.empty(0, np.uint8)

    def encode(self, classes: Bytes, bit_fields: Bytes, flags: Bytes) -> bytes:
        """Return the class layer of a chunk, which is empty if all points have one class.

        Parameters
        ----------
        classes, bit_fields, flags : uint8, shape (n,)
            Classes, bytes with the returns, and bytes with the flags and the scanner channel, one or more each.
        """
        if (classes == classes[0]).all():
            return b""
        needed = _MAX_SYMBOL_BYTES * classes.size + _END_BYTES
        if self._out.size < needed:
            self._out = np.empty(needed, np.uint8)
        self._state[:] = 0
        self._last[:] = -1
        models = (self._counts, self._lower, self._state)
        size = _encode(classes, bit_fields, flags, models, self._last, self._out)
        return self._out[:size].tobytes()


@kernel
def _update(counts: Int32, lower: Int32, state: Int32) -> None:
    """Compute the probabilities of a model from its counts: ``lower`` is that of all lower symbols, in units of 2**-15.

    Counts are halved when their sum exceeds 2**15, so that a model follows the latest symbols.
    """
    total = as_int64(state[_TOTAL]) + state[_CYCLE]
    if total > 1 << _PROBABILITY_BITS:
        total = 0
        for symbol in range(_SYMBOLS):
            counts[symbol] = (counts[symbol] + 1) >> 1
            total += counts[symbol]
    scale = (_RANGE >> 1) // total
    below = 0
    for symbol in range(_SYMBOLS):
        lower[symbol] = (scale * below) >> (31 - _PROBABILITY_BITS)
        below += counts[symbol]
    cycle = min((5 * as_int64(state[_CYCLE])) >> 2, _LAST_CYCLE)
    state[_TOTAL], state[_CYCLE], state[_LEFT] = total, cycle, cycle


@kernel
def _start(counts: Int32, lower: Int32, state: Int32) -> None:
    """Make all symbols of a model equally probable."""
    counts[:] = 1
    state[_TOTAL], state[_CYCLE] = 0, _SYMBOLS
    _update(counts, lower, state)
    state[_CYCLE], state[_LEFT] = _FIRST_CYCLE, _FIRST_CYCLE


@kernel
def _carry(out: Bytes, size: int) -> None:
    """Add 1 to the number of ``size`` bytes that was written so far."""
    place = size - 1
    while out[place] == 255:
        out[place] = 0
        place -= 1
    out[place] += 1


@kernel
def _encode(
    classes: Bytes,
    bit_fields: Bytes,
    flags: Bytes,
    models: tuple[Int32, Int32, Int32],
    last: Int32,
    out: Bytes,
) -> int:
    """Write the layer to ``out``, and return its number of bytes.

    ``last`` is the last class of each channel, -1 if there is none yet. A new channel continues
    with the class of the point before. The first record of a chunk is not in its layers.
    """
    counts, lower, state = models
    base, length, size = 0, _RANGE - 1, 0
    channel = (flags[0] >> 4) & 3
    last[channel] = classes[0]
    for i in range(1, classes.size):
        before = as_int64(last[channel])
        channel = (flags[i] >> 4) & 3
        if last[channel] >= 0:
            before = as_int64(last[channel])
        # The only return is number 1 of 1, or of 0 in faulty files.
        single = (bit_fields[i] & 0xEF) == 1
        model = as_int64(channel) * _MODELS_OF_CHANNEL + ((before & 31) << 1) + single
        if state[model, _CYCLE] == 0:
            _start(counts[model], lower[model], state[model])
        symbol = as_int64(classes[i])
        last[channel] = symbol
        step = length >> _PROBABILITY_BITS
        begin = lower[model, symbol] * step
        # The last symbol gets what rounding left.
        end = length if symbol == _SYMBOLS - 1 else lower[model, symbol + 1] * step
        base, length = base + begin, end - begin
        if base >= _RANGE:
            base -= _RANGE
            _carry(out, size)
        while length < _TOP_BYTE:
            out[size] = base >> 24
            size += 1
            base, length = (base << 8) & (_RANGE - 1), length << 8
        counts[model, symbol] += 1
        state[model, _LEFT] -= 1
        if state[model, _LEFT] == 0:
            _update(counts[model], lower[model], state[model])
    # A number inside the interval, as short as possible: one byte, or two if the interval is short.
    # LASzip adds zeros, since its decoder reads four bytes ahead.
    digits = 1 if length > 2 * _TOP_BYTE else 2
    base += _TOP_BYTE if digits == 1 else _TOP_BYTE >> 1
    if base >= _RANGE:
        base -= _RANGE
        _carry(out, size)
    for _ in range(digits):
        out[size] = base >> 24
        size += 1
        base = (base << 8) & (_RANGE - 1)
    zeros = 4 - digits
    out[size : size + zeros] = 0
    return size + zeros
