"""An error names the reason why a vector file cannot be written."""

from __future__ import annotations

import signal
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import shapely

from tests.scenes.journals import n_features, opened_in_gis
from tiler.errors import ProcessingError
from tiler.io.vector.writing import geopackage


@pytest.mark.skipif(
    not hasattr(signal, "SIGXFSZ"), reason="this system has no limit of the size of files"
)
def test_a_file_that_may_not_grow_is_reported_as_such(tmp_path: Path) -> None:
    """GDAL itself only says "Failed to commit transaction"."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, before[1]))
    try:
        points = [shapely.Point(i, i) for i in range(20_000)]
        refused = pytest.raises(
            ProcessingError, match=r"x\.gpkg: cannot be written \(File too large\)"
        )
        with refused, geopackage(tmp_path / "x.gpkg", "EPSG:32632") as file:
            file.add("a", "Point", points, {"n": np.arange(len(points))})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)
    assert not list(tmp_path.iterdir())


def test_a_file_that_was_opened_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "x.gpkg"
    with geopackage(path, "EPSG:32632") as file:
        file.add("a", "Point", [shapely.Point(0, 0)], {"n": np.arange(1)})
    with (
        closing(opened_in_gis(path)),
        pytest.raises(ProcessingError, match=r"^x\.gpkg-wal: its GeoPackage is open"),
        geopackage(path, "EPSG:32632") as file,
    ):
        file.add("a", "Point", [shapely.Point(1, 1)], {"n": np.arange(1)})
    assert n_features(path) == 2
    assert list(tmp_path.iterdir()) == [path]
