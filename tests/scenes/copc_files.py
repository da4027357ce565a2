"""COPC files for tests: the points of a cloud in an octree, the upper levels thinned."""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import lazrs
import numpy as np
import numpy.typing as npt

MOST = 20_000
"""Points of a node, of those that have children too."""


def write_copc(path: Path, las: laspy.LasData, most: int = MOST) -> Path:
    """Write the points of a cloud of format 6, 7 or 8 as COPC 1.0."""
    xyz = np.asarray(las.xyz)
    low, side = xyz.min(axis=0), float(np.ptp(xyz, axis=0).max()) or 1.0
    nodes = nodes_of(xyz, low, side, most)
    vlrs = [v for v in las.header.vlrs if v.user_id not in ("laszip encoded", "copc")]
    info = laspy.VLR("copc", 1, "", bytes(160))
    header = laspy.LasHeader(version="1.4", point_format=las.header.point_format)
    header.scales, header.offsets = las.header.scales, las.header.offsets
    header.creation_date, header.global_encoding.wkt = las.header.creation_date, True
    laszip = lazrs.LazVlr.new_for_compression(las.header.point_format.id, 0, True)
    header.vlrs = laspy.vlrs.vlrlist.VLRList(
        [info, *vlrs, laspy.VLR("laszip encoded", 22204, "", bytes(laszip.record_data()))]
    )
    header.update(las.points)
    with open(path, "w+b") as file:
        header.write_to(file)
        begin = file.tell()
        entries = _write_nodes(file, laszip, np.ascontiguousarray(las.points.array), nodes)
        file.seek(0, 2)
        page = file.tell() + 60
        file.write(struct.pack("<H16sHQ32s", 0, b"copc", 1000, len(entries) * 32, b""))
        for entry in entries:
            file.write(struct.pack("<iiiiQii", *entry))
        centre = low + side / 2
        raw = struct.pack(
            "<5dQQdd88x", *centre, side / 2, side / 100, page, len(entries) * 32, 0.0, 0.0
        )
        _patch(file, 375 + 54, raw)
        _patch(file, 96, struct.pack("<I", begin))
        _patch(file, 104, struct.pack("<B", las.header.point_format.id | 0x80))
        _patch(file, 235, struct.pack("<QI", page - 60, 1))
    return path


def nodes_of(
    xyz: npt.NDArray[np.float64], low: npt.NDArray[np.float64], side: float, most: int
) -> dict[tuple[int, int, int, int], npt.NDArray[np.int64]]:
    """Rows of each node by its key: the first ``most`` in a random order, the others below."""
    rng = np.random.default_rng(1)
    found: dict[tuple[int, int, int, int], npt.NDArray[np.int64]] = {}
    todo = [((0, 0, 0, 0), rng.permutation(len(xyz)))]
    while todo:
        (level, *place), rows = todo.pop()
        found[level, place[0], place[1], place[2]] = np.sort(rows[:most])
        rest = rows[most:]
        if not rest.size:
            continue
        cell = side / 2 ** (level + 1)
        child = np.clip(((xyz[rest] - low) / cell).astype(np.int64), 0, 2 ** (level + 1) - 1)
        for key in np.unique(child, axis=0):
            todo.append(((level + 1, *map(int, key)), rest[(child == key).all(axis=1)]))
    return found


def _write_nodes(
    file: object,
    laszip: object,
    records: npt.NDArray[np.void],
    nodes: dict[tuple[int, ...], npt.NDArray[np.int64]],
) -> list[tuple[int, ...]]:
    """One chunk for each node; key, offset, bytes and points of each."""
    begin = file.tell()
    compressor = lazrs.LasZipCompressor(file, laszip)
    for rows in nodes.values():
        compressor.compress_many(np.frombuffer(records[rows].tobytes(), np.uint8))
        compressor.finish_current_chunk()
    compressor.done()
    file.flush()
    file.seek(begin)
    table = lazrs.read_chunk_table(file, laszip)
    place, entries = begin + 8, []
    for key, (points, size) in zip(nodes, table, strict=False):
        entries.append((*key, place, size, points))
        place += size
    return entries


def _patch(file: object, position: int, data: bytes) -> None:
    file.seek(position)
    file.write(data)
