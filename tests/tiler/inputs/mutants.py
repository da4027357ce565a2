"""Mutations of LAS and LAZ files: fields, records, chunks, ends; the same seed gives the same mutants."""

from __future__ import annotations

import hashlib
import math
import random
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tiler.core.lattice import CoordFrame
from tiler.errors import InputError
from tiler.ingest.spool import columns, to_local_counts
from tiler.inputs import inspect, pieces
from tiler.io.las.headers import read_header
from tiler.io.las.reader import EVERYTHING, PointReader
from tiler.schedule.worker import peak_rss_bytes

FIELDS = {
    "encoding": (6, "H"), "minor": (25, "B"), "header size": (94, "H"), "points offset": (96, "I"),
    "records": (100, "I"), "format": (104, "B"), "record length": (105, "H"), "legacy count": (107, "I"),
    "x scale": (131, "d"), "y scale": (139, "d"), "z scale": (147, "d"), "x offset": (155, "d"),
    "y offset": (163, "d"), "z offset": (171, "d"), "highest x": (179, "d"), "lowest x": (187, "d"),
    "highest y": (195, "d"), "lowest y": (203, "d"), "highest z": (211, "d"), "lowest z": (219, "d"),
    "waveforms": (227, "Q"), "extended": (235, "Q"), "extended count": (243, "I"), "count": (247, "Q"),
}  # fmt: skip
INTEGERS = {
    "B": (0, 1, 3, 6, 0x80, 0x83, 0x86, 0xC3, 0xFF),
    "H": (0, 1, 20, 227, 375, 0x7FFF, 0xFFFF),
    "I": (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 10**6),
    "Q": (0, 1, 2**31, 2**32, 2**62, 2**63, 2**64 - 1),
}
FINITE = (0.0, -0.0, -1.0, 5e-324, 1e-300, 1e-9, 1e300, 1e7, -1e15)
DOUBLES = (*FINITE, math.inf, -math.inf, math.nan)


@dataclass(frozen=True)
class Mutant:
    """A damaged file, a description of the damage, and whether its points must equal those of the fixture."""

    name: str
    data: bytes
    points_untouched: bool = False


@dataclass(frozen=True)
class Reading:
    """Result of reading a whole file."""

    points: int
    placed: int
    digest: str
    peak_rss_bytes: int


def read_whole(path: Path, salvage: bool) -> Reading:
    """All steps of ingest for a file, without the store."""
    try:
        info = inspect(path, salvage)
        header = read_header(path, salvage)
        digest = hashlib.blake2b()
        points = placed = 0
        with PointReader(header, EVERYTHING) as reader:
            for start, count in pieces(info):
                records = reader.read(start, count)
                digest.update(records.tobytes())
                local, keep, dropped, _ = to_local_counts(records, header, CoordFrame())
                assert int(keep.sum()) + sum(dropped.values()) == len(records) == count
                columns(records, header, local, 0, np.arange(points, points + count), True)
                points, placed = points + count, placed + int(keep.sum())
        assert points == info.points
        return Reading(points, placed, digest.hexdigest(), peak_rss_bytes())
    except MemoryError as error:
        raise AssertionError("out of memory") from error


def mutants(data: bytes, seed: str, number: int) -> Iterator[Mutant]:
    """``number`` mutants of a file."""
    for i in range(number):
        rng = random.Random(f"{seed}/{i}")
        kind = rng.choice(
            (_field, _field, _field, _records, _records, _table, _bits, _bits, _cut, _block)
        )
        mutant = kind(data, rng)
        yield Mutant(f"{seed}/{i}: {mutant.name}", mutant.data, mutant.points_untouched)


def _patched(data: bytes, position: int, form: str, value: Any) -> bytes:
    changed = bytearray(data)
    if position + struct.calcsize("<" + form) <= len(data):
        struct.pack_into("<" + form, changed, position, value)
    return bytes(changed)


def _field(data: bytes, rng: random.Random) -> Mutant:
    """One field of the header gets a false value."""
    name = rng.choice(sorted(FIELDS))
    position, form = FIELDS[name]
    value = rng.choice(DOUBLES) if form == "d" else rng.choice(INTEGERS[form])
    if form != "d" and rng.random() < 0.3:  # near the truth
        (true,) = struct.unpack_from("<" + form, data.ljust(400, b"\0"), position)
        value = max(true + rng.choice((-1, 1, 7, -20)), 0) % 2 ** (8 * struct.calcsize(form))
    return Mutant(f"{name} = {value}", _patched(data, position, form, value))


def _records(data: bytes, rng: random.Random) -> Mutant:
    """A byte or a word between the header and the points: variable length records, and their lengths."""
    start, stop = struct.unpack_from("<H", data, 94)[0], struct.unpack_from("<I", data, 96)[0]
    if stop - start < 8:
        return _field(data, rng)
    position = rng.randrange(start, stop - 8)
    if rng.random() < 0.4:  # the length of the first record
        position = start + 20
    form = rng.choice("BHIQ")
    value = rng.choice((*INTEGERS[form], rng.randrange(2 ** (8 * struct.calcsize(form)))))
    return Mutant(f"byte {position} = {value} ({form})", _patched(data, position, form, value))


def _table(data: bytes, rng: random.Random) -> Mutant:
    """The position of the table of chunks, its number of chunks, or its content."""
    (points,) = struct.unpack_from("<I", data, 96)
    if not data[104] & 0x80 or points + 8 > len(data):
        return _bits(data, rng)
    (table,) = struct.unpack_from("<q", data, points)
    place = rng.choice(("pointer", "chunks", "entries", "first chunk"))
    if place == "pointer":
        value = rng.choice(
            (0, -1, len(data), len(data) - 8, table + 1, table - 1, 2**62, points + 8)
        )
        return Mutant(f"table at {value}", _patched(data, points, "q", value))
    if place == "chunks":
        return Mutant(
            "chunks", _patched(data, table + 4, "I", rng.choice((*INTEGERS["I"], 2, 3, 1000)))
        )
    # its head: number of points and bytes of each layer where there are layers
    if place == "first chunk":
        return Mutant(
            "first chunk",
            _patched(data, points + 8 + 4 * rng.randrange(30), "I", rng.choice(INTEGERS["I"])),
        )
    position = rng.randrange(min(table + 8, len(data) - 1), len(data))
    return Mutant(f"table byte {position}", _patched(data, position, "B", rng.randrange(256)))


def _bits(data: bytes, rng: random.Random) -> Mutant:
    """Up to thirty bits anywhere."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8, 30))):
        changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return Mutant("bits", bytes(changed))


def _cut(data: bytes, rng: random.Random) -> Mutant:
    """The file is cut short, or gets more bytes at its end."""
    if rng.random() < 0.2:
        # If the header says 0 points, such a file is refused as unfinished.
        position, form = FIELDS["count" if data[25] >= 4 else "legacy count"]
        (points,) = struct.unpack_from("<" + form, data, position)
        return Mutant("longer", data + rng.randbytes(rng.choice((1, 8, 1000))), points > 0)
    size = rng.choice(
        (rng.randrange(len(data)), rng.randrange(min(len(data), 700)), len(data) - 1)
    )
    return Mutant(f"cut to {size}", data[:size])


def _block(data: bytes, rng: random.Random) -> Mutant:
    """A run of bytes is zero, one, random, or another part of the file."""
    start = rng.randrange(len(data))
    size = min(rng.choice((4, 64, 512, 4096)), len(data) - start)
    other = rng.randrange(len(data) - size + 1)
    filling = rng.choice(
        (bytes(size), b"\xff" * size, rng.randbytes(size), data[other : other + size])
    )
    return Mutant(
        f"bytes {start} to {start + size}", data[:start] + filling + data[start + size :]
    )


def check(path: Path, reading: Reading | InputError) -> None:
    """A correct read, or one clear line."""
    if isinstance(reading, InputError):
        text = str(reading)
        assert text.startswith(f"{path}: "), text
        assert "\n" not in text, text
        assert "; " in text, text
        return
    assert 0 <= reading.placed <= reading.points
    assert reading.peak_rss_bytes < 1 << 30
