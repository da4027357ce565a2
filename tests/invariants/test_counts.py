"""Points read = stored + dropped by reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.invariants import clouds
from tests.invariants.clouds import CORNER, Cloud
from tests.invariants.runs import do, the_store
from tiler.errors import InputError


@pytest.fixture
def mixed(city: Cloud, tmp_path: Path) -> list[Path]:
    """Two files: noise, water and withheld points in one, the same points again in the other."""
    classes = np.full(len(city), 1, np.uint8)
    classes[::7], classes[1::11] = 9, 18
    withheld = np.zeros(len(city), np.bool_)
    withheld[2::13] = True
    return [
        clouds.write(tmp_path / "a.laz", city, classes=classes, withheld=withheld),
        clouds.write(tmp_path / "b.laz", city.take(np.arange(len(city)) % 3 == 0)),
    ]


def test_every_point_is_stored_or_dropped_for_a_reason(
    mixed: list[Path], city: Cloud, tmp_path: Path
) -> None:
    x, y = CORNER
    bounds = [x + 90.5, y + 20.25, x + 170.0, y + 300.0]
    settings = {"bounds": bounds, "halo": "5", "max_edge": "10"}
    result = do(mixed, tmp_path / "out", until="ingest", **settings)
    counts, bucket, margin = (
        result.summary["counts"],
        the_store(tmp_path / "out").meta.bucket,
        10_100,
    )
    # A point is read if its bucket comes within the margin of the bounds.
    box = [
        round(v * 1000) + side * margin for v, side in zip(bounds, (-1, -1, 1, 1), strict=True)
    ]
    ix, iy = (
        bucket.index(np.rint((city.xyz[:, k] + CORNER[k]) * 1000).astype(np.int64))
        for k in (0, 1)
    )
    inside = (ix >= bucket.index_of(box[0])) & (ix <= bucket.index_of(box[2]))
    inside &= (iy >= bucket.index_of(box[1])) & (iy <= bucket.index_of(box[3]))
    expected = int(inside.sum()) + int(inside[::3].sum())
    assert expected < counts["read"]
    assert counts["read"] == len(city) + len(city.xyz[::3])
    assert counts["stored"] == expected
    assert counts["dropped"] == {"outside the area": counts["read"] - expected}
    assert sum(info.n for info in the_store(tmp_path / "out").buckets().values()) == expected
    assert sum(i["stored"] for i in result.summary["inputs"]) == expected


def test_kept_out_and_participating_make_all_stored(
    mixed: list[Path], city: Cloud, tmp_path: Path
) -> None:
    result = do(mixed, tmp_path / "out", until="filter")
    counts, n = result.summary["counts"], np.arange(len(city))
    out = (n % 7 == 0) | (n % 11 == 1) | (n % 13 == 2)
    assert counts["dropped"] == {}
    assert counts["kept_out"] == int(out.sum())
    assert counts["participating"] == counts["stored"] - counts["kept_out"]
    assert counts["duplicates_between_files"] == len(city.xyz[::3])
    assert counts["duplicates_within_files"] == len(city) - len(np.unique(city.xyz, axis=0))
    found = result.summary["filter"]
    assert found["kept"] == counts["kept_out"]
    total = found["kept"] + found["ground"] + found["low_noise"] + found["unclassified"]
    assert found["points"] == total == counts["stored"]


def test_a_run_that_drops_everything_says_so(
    city_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "tiler.ingest.spool.fits_int32", lambda local: np.zeros(local.shape, np.bool_)
    )
    with pytest.raises(InputError, match="points were dropped"):
        do(city_file, tmp_path / "out")
