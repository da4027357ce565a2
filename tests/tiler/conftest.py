"""Generated LAS and LAZ files, and a store in memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from pyproj import CRS

from tiler.core.lattice import Cell, CoordFrame, Lattice
from tiler.core.points import PointBlock
from tiler.store import StoreMeta, TileStore, create_store

MakeCloud = Callable[..., Path]


@dataclass
class Meta:
    frame: CoordFrame = field(default_factory=CoordFrame)
    bucket: Lattice = field(default_factory=lambda: Lattice(Fraction(50_000)))
    fine: Lattice = field(default_factory=lambda: Lattice(Fraction(500)))
    has_rgb: bool = False


@dataclass
class MemoryStore:
    """What ingest and the exporter ask of a store, in dictionaries."""

    meta: Meta = field(default_factory=Meta)
    pieces: dict[str, PointBlock] = field(default_factory=dict)
    written: dict[Cell, PointBlock] = field(default_factory=dict)
    candidates: dict[Cell, int] = field(default_factory=dict)
    labels: dict[tuple[str, Cell], np.ndarray] = field(default_factory=dict)

    def write_piece(self, piece: str, block: PointBlock) -> None:
        self.pieces[piece] = block

    def read_fragment(self, piece: str, start: int, stop: int) -> PointBlock:
        return self.pieces[piece].take(slice(start, stop))

    def write_bucket(self, cell: Cell, block: PointBlock, n_candidates: int) -> None:
        self.written[cell], self.candidates[cell] = block, n_candidates

    def read_bucket(self, cell: Cell, columns: tuple[str, ...] = ("xyz",)) -> PointBlock:
        return self.written[cell]

    def read_origin(self, cell: Cell) -> np.ndarray:
        return self.written[cell].origin

    def area(self, key: str | None) -> None:
        assert key is None

    def read_labels(self, name: str, cell: Cell) -> np.ndarray:
        return self.labels[name, cell]


@pytest.fixture
def memory_store() -> MemoryStore:
    """A store in memory."""
    return MemoryStore()


@pytest.fixture
def small_store(tmp_path: Path) -> TileStore:
    """A new store in a folder, with buckets of ten metres."""
    meta = StoreMeta(CoordFrame(), Lattice(Fraction(10_000)), Lattice(Fraction(1000)), False)
    return create_store(str(tmp_path / "store.zarr"), meta)


def _fill(cloud: laspy.LasData, n: int, rng: np.random.Generator) -> None:
    """Every field of every record gets something of its own."""
    raw = rng.integers(0, 256, size=n * cloud.points.array.itemsize, dtype=np.uint8)
    cloud.points.array[:] = np.frombuffer(raw.tobytes(), dtype=cloud.points.array.dtype)
    for axis, reach in (("X", 200_000), ("Y", 150_000), ("Z", 5_000)):
        cloud.points.array[axis] = rng.integers(-reach, reach, n)
    if cloud.point_format.id in (9, 10):
        # one scanner channel: see the exporter
        cloud.points.array["classification_flags"] &= 0xCF
    if "gps_time" in cloud.points.array.dtype.names:
        cloud.points.array["gps_time"] = np.sort(rng.uniform(0, 1e6, n))
        cloud.points.array["gps_time"][:1] = np.nan


def without_sensor(las: laspy.LasData) -> None:
    """Take away all that shows a sensor; places, classes and colours stay."""
    for name in (
        "intensity",
        "number_of_returns",
        "scan_angle_rank",
        "point_source_id",
        "edge_of_flight_line",
    ):
        las[name][:] = 0
    las.scan_direction_flag[:] = 0
    if "gps_time" in las.point_format.dimension_names:
        las.gps_time[:] = 0


@pytest.fixture
def make_cloud(tmp_path: Path) -> MakeCloud:
    """A function that writes a cloud of random records and returns its path."""

    def make(
        name: str = "cloud.las",
        n: int = 1000,
        point_format: int = 3,
        version: str = "1.2",
        crs: Any = "EPSG:25832",
        scales: tuple[float, float, float] = (0.01, 0.01, 0.01),
        offsets: tuple[float, float, float] = (500_000.0, 5_400_000.0, 0.0),
        seed: int = 0,
        extra: bool = False,
        evlr: bytes | None = None,
        edit: Callable[[laspy.LasData], None] | None = None,
    ) -> Path:
        header = laspy.LasHeader(point_format=point_format, version=version)
        header.scales, header.offsets = np.array(scales), np.array(offsets)
        header.system_identifier, header.generating_software = "a scanner", "a test"
        if extra:
            header.add_extra_dim(laspy.ExtraBytesParams("echo_width", np.float32))
        header.vlrs.append(
            laspy.VLR("mine", 7, "a record of the user's", b"\x00\x01secret\x00")
        )
        if crs is not None:
            wkt = CRS.from_user_input(crs).to_wkt("WKT1_GDAL", output_axis_rule=False) + "\0"
            header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "WKT", wkt.encode()))
            header.global_encoding.wkt = version == "1.4"
        cloud = laspy.LasData(header)
        cloud.points = laspy.ScaleAwarePointRecord.zeros(n, header=header)
        _fill(cloud, n, np.random.default_rng(seed))
        if edit is not None:
            edit(cloud)
        if evlr is not None:
            cloud.evlrs = laspy.vlrs.vlrlist.VLRList(
                [laspy.VLR("mine", 9, "an extended one", evlr)]
            )
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".laz":
            cloud.write(path, laz_backend=laspy.LazBackend.Lazrs)
        else:
            cloud.write(path)
        return path

    return make
