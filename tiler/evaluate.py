"""Scores against the truth: labels of a cloud, heights of a DTM.

Labels as Sithole and Vosselman define it (2004, Experimental comparison of filter algorithms for bare-Earth
extraction from airborne laser scanning point clouds, ISPRS J. 59), with ``a`` ground kept, ``b`` ground lost,
``c`` object taken for ground, ``d`` object kept out: type I = b / (a + b), type II = c / (c + d), and
total = (b + c) / n.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.core.classes import GROUND
from tiler.errors import ConfigError, InputError
from tiler.las.columns import class_and_flags
from tiler.las.headers import read_header
from tiler.las.reader import NEEDED, PointReader

IGNORED = (7, 9, 17, 18, 26, 64, 65, 66, 67)
"""Reference classes that are neither: noise, water, bridges, the producers' virtual points and artefacts."""

_STEP = 1_000_000
_PER_UNIT = 10_000  # coordinates are compared as counts of a tenth of a millimetre

UInt8s = npt.NDArray[np.uint8]
Int64s = npt.NDArray[np.int64]


def confusion(labels: UInt8s, reference: UInt8s, ignore: Sequence[int] = IGNORED) -> Int64s:
    """Count the pairs of labels.

    Parameters
    ----------
    labels, reference : uint8, shape (n,)
        ASPRS classes of the same points: to be judged, and true.
    ignore : sequence of int
        Reference classes that are left out.

    Returns
    -------
    int64, shape (5,)
        a, b, c, d as above, and how many were left out.
    """
    if labels.shape != reference.shape:
        raise InputError(f"{labels.size} labels against {reference.size} true ones; compare the same points")
    left_out = np.zeros(256, np.bool_)
    left_out[list(ignore)] = True
    seen = ~left_out[reference]
    kind = 2 * (reference[seen] != GROUND).astype(np.int64) + (labels[seen] != GROUND)
    return np.append(np.bincount(kind, minlength=4), reference.size - int(seen.sum())).astype(np.int64)


def scores(counts: Int64s) -> dict[str, Any]:
    """Errors and agreement from the five counts of `confusion`.

    Returns
    -------
    dict
        ``points`` and ``ignored``; ``ground_kept``, ``ground_lost``, ``object_taken``, ``object_kept``; as
        fractions ``type_1``, ``type_2``, ``total``, ``kappa`` (Cohen), ``f1`` (of ground), None where there
        is nothing to divide by.
    """
    a, b, c, d, ignored = (int(n) for n in counts)
    n = a + b + c + d
    chance = (a + b) * (a + c) + (c + d) * (b + d)
    return {
        "points": n, "ignored": ignored,
        "ground_kept": a, "ground_lost": b, "object_taken": c, "object_kept": d,
        "type_1": _ratio(b, a + b), "type_2": _ratio(c, c + d), "total": _ratio(b + c, n),
        "kappa": _ratio((a + d) * n - chance, n * n - chance), "f1": _ratio(2 * a, 2 * a + b + c),
    }  # fmt: skip


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def evaluate_labels(labels: UInt8s, reference: UInt8s, ignore: Sequence[int] = IGNORED) -> dict[str, Any]:
    """Return `scores` of two label arrays, see `confusion`."""
    return scores(confusion(labels, reference, ignore))


def evaluate_files(
    cloud: Path | str, reference: Path | str, ignore: Sequence[int] = IGNORED
) -> dict[str, Any]:
    """Score the classes of a cloud against those of a reference cloud.

    Files with the same points in the same order are read side by side in bounded memory. Otherwise each
    point of the reference is looked up in the cloud by its exact coordinates (both are then held in memory);
    points that lie at one place are paired in the order of their files.

    Returns
    -------
    dict
        As `scores`, and ``matched_by`` (``order`` or ``coordinates``), ``unmatched_reference`` and
        ``unmatched_cloud`` (points without a partner).

    Raises
    ------
    InputError
        A file cannot be read, or no point of the reference is in the cloud.
    """
    cloud, reference = Path(cloud), Path(reference)
    counts, matched_by, unmatched = _in_order(cloud, reference, ignore), "order", (0, 0)
    if counts is None:
        labels, truth, unmatched = _by_coordinates(cloud, reference)
        counts, matched_by = confusion(labels, truth, ignore), "coordinates"
    return {
        **scores(counts),
        "ignore": sorted(ignore),
        "matched_by": matched_by,
        "unmatched_reference": unmatched[0],
        "unmatched_cloud": unmatched[1],
    }


def _read(path: Path) -> Iterator[tuple[Int64s, UInt8s]]:
    """Coordinates (int64 counts, shape (3, n)) and classes of a file, piece by piece."""
    header = read_header(path)
    with PointReader(header, NEEDED) as reader:
        for start in range(0, header.point_count, _STEP):
            records = reader.read(start, min(_STEP, header.point_count - start))
            place = np.stack([
                np.round((records[axis] * scale + offset) * _PER_UNIT).astype(np.int64)
                for axis, scale, offset in zip("XYZ", header.scales, header.offsets, strict=True)
            ])  # fmt: skip
            yield place, class_and_flags(records, header.point_format)[0]


def _in_order(cloud: Path, reference: Path, ignore: Sequence[int]) -> Int64s | None:
    """`confusion` of two files with the same points in the same order, None if they are not."""
    if read_header(cloud).point_count != read_header(reference).point_count:
        return None
    counts = np.zeros(5, np.int64)
    for (place, labels), (true_place, truth) in zip(_read(cloud), _read(reference), strict=True):
        if not np.array_equal(place, true_place):
            return None
        counts += confusion(labels, truth, ignore)
    return counts


def _by_coordinates(cloud: Path, reference: Path) -> tuple[UInt8s, UInt8s, tuple[int, int]]:
    """Labels and truth of the points that both have, and how many only the reference, only the cloud has."""
    (place, labels), (true_place, truth) = _whole(cloud), _whole(reference)
    both = np.concatenate((place, true_place), axis=1)
    if both.shape[1] == 0:
        raise InputError(f"{cloud} and {reference}: no points; nothing to compare")
    # The n-th point at a place pairs with the n-th point of the other file there, whatever stands between.
    order = np.lexsort((both[2], both[1], both[0]))
    ordered = both[:, order]
    new = np.r_[True, np.any(ordered[:, 1:] != ordered[:, :-1], axis=0)]
    group = np.empty(len(order), np.int64)
    group[order] = np.cumsum(new) - 1
    mine, other = (_numbered(part) for part in np.split(group, [place.shape[1]]))
    _, in_cloud, in_reference = np.intersect1d(mine, other, assume_unique=True, return_indices=True)
    if len(in_cloud) == 0:
        raise InputError(f"{reference}: none of its points is in {cloud}; name the reference of this cloud")
    return (
        labels[in_cloud],
        truth[in_reference],
        (len(truth) - len(in_reference), len(labels) - len(in_cloud)),
    )


def _numbered(group: Int64s) -> Int64s:
    """One number for each (place, how many of that place came before)."""
    order = np.argsort(group, kind="stable")
    ordered = group[order]
    start = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]]) if len(group) else np.empty(0, np.intp)
    turn = np.arange(len(group)) - np.repeat(start, np.diff(np.r_[start, len(group)]))
    out = np.empty(len(group), np.int64)
    out[order] = (ordered << 24) + np.minimum(turn, (1 << 24) - 1)
    return out


def _whole(path: Path) -> tuple[Int64s, UInt8s]:
    parts = list(_read(path))
    if not parts:
        return np.empty((3, 0), np.int64), np.empty(0, np.uint8)
    return np.concatenate([p for p, _ in parts], axis=1), np.concatenate([c for _, c in parts])


def evaluate_dtm(dtm: Path | str, truth: Path | str) -> dict[str, Any]:
    """Differences ``dtm - truth`` over the pixels that both have.

    Parameters
    ----------
    dtm, truth : path
        Single-band rasters of the same CRS and pixel size on the same pixel lattice; extents may differ.

    Returns
    -------
    dict
        ``pixels``; ``only_dtm``, ``only_truth`` (valid pixels that the other lacks, within the common extent);
        in units of the heights ``rmse``, ``bias`` (mean), ``median``, ``nmad`` (1.4826 times the median
        absolute deviation from the median), ``p5``, ``p95``, ``p95_abs``, ``max_abs``; None without a common
        pixel.

    Raises
    ------
    InputError
        A raster cannot be read.
    ConfigError
        The rasters do not lie on one lattice, or do not overlap.
    """
    mine, true = _common_window(Path(dtm), Path(truth))
    both = np.isfinite(mine) & np.isfinite(true)
    counts = {
        "pixels": int(both.sum()),
        "only_dtm": int((np.isfinite(mine) & ~both).sum()),
        "only_truth": int((np.isfinite(true) & ~both).sum()),
    }
    return {**counts, **_spread(mine[both] - true[both])}


def _spread(difference: npt.NDArray[np.float64]) -> dict[str, float | None]:
    names = ("rmse", "bias", "median", "nmad", "p5", "p95", "p95_abs", "max_abs")
    if difference.size == 0:
        return dict.fromkeys(names)
    median = float(np.median(difference))
    values = (
        np.sqrt(np.mean(difference**2)),
        np.mean(difference),
        median,
        1.4826 * np.median(np.abs(difference - median)),
        *np.percentile(difference, (5, 95)),
        np.percentile(np.abs(difference), 95),
        np.abs(difference).max(),
    )
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def _common_window(dtm: Path, truth: Path) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Heights of both rasters in their common extent, NaN where there is none."""
    import rasterio
    from rasterio.errors import RasterioError

    try:
        with rasterio.open(dtm) as mine, rasterio.open(truth) as true:
            a, b = mine.transform, true.transform
            col, row = (b.c - a.c) / a.a, (b.f - a.f) / a.e
            if not (np.allclose((a.a, a.e), (b.a, b.e)) and _whole_number(col) and _whole_number(row)):
                raise ConfigError(
                    f"{dtm} and {truth} do not lie on one pixel lattice (pixels of {a.a:g} and {b.a:g}, "
                    f"shifted by {col % 1:.3f} and {row % 1:.3f}); make the DTM with the truth's resolution"
                )
            left, top = max(0, round(col)), max(0, round(row))
            right, bottom = (
                min(mine.width, round(col) + true.width),
                min(mine.height, round(row) + true.height),
            )
            if left >= right or top >= bottom:
                raise ConfigError(f"{dtm} and {truth} do not overlap; name the truth of this DTM")
            window = ((top, bottom), (left, right))
            shifted = ((top - round(row), bottom - round(row)), (left - round(col), right - round(col)))
            return _heights(mine, window), _heights(true, shifted)
    except RasterioError as error:
        raise InputError(f"{' '.join(str(error).split())}; name two readable rasters") from error


def _whole_number(value: float) -> bool:
    return abs(value - round(value)) < 1e-3


def _heights(raster: Any, window: tuple[tuple[int, int], tuple[int, int]]) -> npt.NDArray[np.float64]:
    return np.asarray(raster.read(1, window=window, masked=True).astype(np.float64).filled(np.nan))
