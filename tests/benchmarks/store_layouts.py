"""Which layout should the tile store have? Writes one cloud in several and reads a halo window back.

    python tests/benchmarks/store_layouts.py --cloud ../shared/data/autzen/autzen_en.laz --unit
    0.3048 python tests/benchmarks/store_layouts.py --points 500000

Prints a Markdown table: points per second written, milliseconds to read the points of 3 x 3
buckets (coordinates and attributes; coordinates of the candidates; all columns), bytes fetched
for the candidates, objects per bucket and bytes per point. Times are the best of three, in one
thread, from a warm cache.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BloscCodec, Crc32cCodec
from zarr.storage import LocalStore

WIDTHS = {
    "xyz": (3, "int32"),
    "attributes": (4, "uint8"),
    "rgb": (3, "uint16"),
    "origin": (1, "int64"),
}
READS = ((("xyz", "attributes"), False), (("xyz",), True), (tuple(WIDTHS), False))


@dataclass(frozen=True)
class Bucket:
    """A run of points: place in the lattice, start, count, candidates."""

    ix: int
    iy: int
    start: int
    n: int
    candidates: int

    @property
    def name(self) -> str:
        return f"{self.ix}_{self.iy}"


@dataclass(frozen=True)
class Cloud:
    """Columns (width, n), sorted by bucket, candidates first."""

    columns: dict[str, np.ndarray]
    buckets: list[Bucket]

    @property
    def n(self) -> int:
        return int(self.columns["xyz"].shape[1])

    def window(self) -> list[Bucket]:
        """The 3 x 3 buckets around the middle one."""
        middle = self.buckets[len(self.buckets) // 2]
        return [
            b for b in self.buckets if max(abs(b.ix - middle.ix), abs(b.iy - middle.iy)) <= 1
        ]


class CountingStore(LocalStore):
    """A local store that counts the bytes fetched."""

    fetched = 0

    async def get(self, *args: Any, **kwargs: Any) -> Any:
        value = await super().get(*args, **kwargs)
        CountingStore.fetched += 0 if value is None else len(value)
        return value


@dataclass(frozen=True)
class Layout:
    """How to store a cloud: ``row`` 0 is one group of arrays per bucket, otherwise points per row of the columns."""

    row: int = 131072
    inner: int = 0
    codec: str = "zstd"
    level: int = 3
    shuffle: str = "shuffle"

    @property
    def name(self) -> str:
        kind = f"columns, rows of {self.row // 1024}k" if self.row else "group per bucket"
        shards = f", shards of {self.inner // 1024}k" if self.inner else ""
        return f"{kind}{shards}, {self.codec} {self.level} {self.shuffle}"

    def write(self, root: Path, cloud: Cloud) -> None:
        """Write all columns of a cloud."""
        group = zarr.create_group(str(root), zarr_format=3)
        if self.row == 0:
            for bucket in cloud.buckets:
                part = group.create_group(bucket.name)
                for name in WIDTHS:
                    shape = (WIDTHS[name][0], bucket.n)
                    array = self._array(part, name, shape, (shape[0], min(bucket.n, 131072)))
                    array[...] = cloud.columns[name][:, bucket.start : bucket.start + bucket.n]
            return
        rows = sum(-(-b.n // self.row) for b in cloud.buckets)
        for name, (width, dtype) in WIDTHS.items():
            array = self._array(group, name, (rows, width, self.row), (1, width, self.row))
            for row, bucket, first in self._rows(cloud):
                n = min(self.row, bucket.n - first)
                values = np.zeros((1, width, self.row), dtype)
                values[0, :, :n] = cloud.columns[name][
                    :, bucket.start + first : bucket.start + first + n
                ]
                array[row : row + 1] = values

    def _rows(self, cloud: Cloud) -> Iterator[tuple[int, Bucket, int]]:
        starts = [
            (bucket, first)
            for bucket in cloud.buckets
            for first in range(0, bucket.n, self.row)
        ]
        for row, (bucket, first) in enumerate(starts):
            yield row, bucket, first

    def _array(
        self, group: Any, name: str, shape: tuple[int, ...], chunks: tuple[int, ...]
    ) -> Any:
        inner = (1, chunks[1], self.inner) if self.inner else chunks
        shuffle: Any = self.shuffle
        codec: Any = self.codec
        return group.create_array(
            name,
            shape=shape,
            chunks=inner,
            shards=chunks if self.inner else None,
            dtype=WIDTHS[name][1],
            compressors=[
                BloscCodec(cname=codec, clevel=self.level, shuffle=shuffle),
                Crc32cCodec(),
            ],
            filters=None,
        )

    def reader(self, root: Path, cloud: Cloud) -> Callable[[Bucket, str, int], np.ndarray]:
        """A function that reads the first n points of a bucket's column."""
        store = CountingStore(root, read_only=True)
        group: Any = zarr.open_group(store, mode="r")
        if self.row == 0:
            return lambda bucket, name, n: group[bucket.name][name][:, :n]
        arrays = {name: group[name] for name in WIDTHS}
        first_row: dict[str, int] = {}
        for row, bucket, _ in self._rows(cloud):
            first_row.setdefault(bucket.name, row)

        def read(bucket: Bucket, name: str, n: int) -> np.ndarray:
            row = first_row[bucket.name]
            parts = [
                arrays[name][row + i, :, : min(self.row, n - i * self.row)]
                for i in range(-(-n // self.row))
            ]
            return np.concatenate(parts, axis=1)

        return read


def bucketed(columns: dict[str, np.ndarray], bucket: int, fine: int) -> Cloud:
    """Sort points by bucket, and in each the lowest point of every fine cell first."""
    x, y, z = columns["xyz"].astype(np.int64)
    key, cell = (y // bucket << 20) + x // bucket, (y // fine << 32) + x // fine
    order = np.lexsort((z, cell))
    lowest = np.zeros(len(x), bool)
    lowest[order] = np.diff(cell[order], prepend=cell[order][:1] - 1) != 0
    order = np.lexsort((~lowest, key))
    keys, starts, counts = np.unique(key[order], return_index=True, return_counts=True)
    candidates = np.add.reduceat(lowest[order], starts, dtype=np.int64)
    lines = np.stack([keys & 0xFFFFF, keys >> 20, starts, counts, candidates], axis=1).tolist()
    return Cloud(
        {n: np.ascontiguousarray(c[:, order]) for n, c in columns.items()},
        [Bucket(*b) for b in lines],
    )


def decoded(path: Path, unit: float) -> Cloud:
    """A cloud from a LAS or LAZ file; ``unit`` metres are one unit of its CRS. Buckets of 100 m, cells of 1 m."""
    import laspy

    las = laspy.read(path)
    xyz = np.round(np.stack([las.x, las.y, las.z]) * 1000).astype(np.int64)
    xyz[:2] -= xyz[:2].min(axis=1, keepdims=True) // 10**6 * 10**6
    attributes = np.stack(
        [las.classification, np.zeros(len(las.x)), las.return_number, las.number_of_returns]
    )
    columns = {
        "xyz": xyz.astype(np.int32),
        "attributes": attributes.astype(np.uint8),
        "rgb": np.stack([las.red, las.green, las.blue]).astype(np.uint16),
        "origin": np.arange(len(las.x), dtype=np.int64)[np.newaxis],
    }
    return bucketed(columns, round(100_000 / unit), round(1_000 / unit))


def generated(n: int) -> Cloud:
    """Eight points a square metre in scan lines over a slope."""
    rng = np.random.default_rng(1)
    side = np.sqrt(n / 8)
    x, y = rng.uniform(0, side, n), np.sort(rng.uniform(0, side, n))
    xyz = np.stack([x, y, 100 + 0.1 * x + rng.normal(0, 0.1, n)]) * 1000
    columns = {
        "xyz": xyz.astype(np.int32),
        "attributes": rng.integers(1, 4, (4, n)).astype(np.uint8),
        "rgb": rng.integers(0, 256, (3, n)).astype(np.uint16) << 8,
        "origin": np.arange(n, dtype=np.int64)[np.newaxis],
    }
    return bucketed(columns, 100_000, 1_000)


def measure(layout: Layout, cloud: Cloud, place: Path) -> str:
    """One line of the table."""
    root = place / "store.zarr"
    shutil.rmtree(root, ignore_errors=True)
    started = time.perf_counter()
    layout.write(root, cloud)
    speed = cloud.n / (time.perf_counter() - started) / 1e6
    times, fetched = [], 0
    for names, candidates in READS:
        best = np.inf
        for _ in range(3):
            started, CountingStore.fetched = time.perf_counter(), 0
            read = layout.reader(root, cloud)
            for bucket in cloud.window():
                n = bucket.candidates if candidates else bucket.n
                for name in names:
                    expected = cloud.columns[name][:, bucket.start : bucket.start + n]
                    if read(bucket, name, n).shape != expected.shape:
                        raise AssertionError(
                            f"{layout.name}: {name} of {bucket.name} came back in another shape"
                        )
            best = min(best, time.perf_counter() - started)
        times.append(f"{best * 1e3:.0f}")
        fetched = CountingStore.fetched if candidates else fetched
    files = [path.stat().st_size for path in root.rglob("*") if path.is_file()]
    return (
        f"| {layout.name} | {speed:.1f} | {' | '.join(times)} | {fetched / 1024:.0f} | "
        f"{len(files) / len(cloud.buckets):.1f} | {sum(files) / cloud.n:.2f} |"
    )


LAYOUTS = (
    Layout(row=0),
    *(Layout(row=row) for row in (32768, 65536, 131072, 262144)),
    *(Layout(inner=inner) for inner in (16384, 32768)),
    Layout(level=1),
    Layout(shuffle="bitshuffle"),
    Layout(codec="lz4", level=5),
)


def main() -> None:
    """Measure every layout and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--cloud", type=Path, help="LAS or LAZ file with colours; default: generated points"
    )
    parser.add_argument(
        "--unit", type=float, default=1.0, help="metres in one unit of the file's CRS [1]"
    )
    parser.add_argument(
        "--points", type=int, default=1_000_000, help="number of generated points [1000000]"
    )
    arguments = parser.parse_args()
    zarr.config.set(
        {"async.concurrency": 8, "threading.max_workers": 1, "array.write_empty_chunks": False}
    )
    cloud = (
        decoded(arguments.cloud, arguments.unit)
        if arguments.cloud
        else generated(arguments.points)
    )
    window = cloud.window()
    print(
        f"{cloud.n} points, {len(cloud.buckets)} buckets; window of {len(window)} buckets: "
        f"{sum(b.n for b in window)} points, {sum(b.candidates for b in window)} candidates\n"
    )
    print(
        "| layout | write Mpt/s | xyz+attributes ms | candidates ms | all ms | candidates KiB | objects | B/point |"
    )
    print("|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as place:
        for layout in LAYOUTS:
            print(measure(layout, cloud, Path(place)), flush=True)


if __name__ == "__main__":
    main()
