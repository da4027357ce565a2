"""Least-squares planes from sums of whole numbers, which do not depend on the order of the points."""

from __future__ import annotations

from ptd.cells import Int64
from ptd.kernel import kernel

MOMENTS = 10
"""Number of moments: n, x, y, z, xx, xy, yy, xz, yz, zz."""


@kernel
def add_point(sums: Int64, x: int, y: int, z: int) -> None:
    """Add a point, in counts from some origin, to moments."""
    moments = (1, x, y, z, x * x, x * y, y * y, x * z, y * z, z * z)
    for m in range(MOMENTS):
        sums[m] += moments[m]


@kernel
def fit_plane(s: Int64, z_ratio: float) -> tuple[float, float, float, float]:
    """Fit the plane ``z = c + a x + b y`` in horizontal counts to moments by least squares.

    Returns a, b, c and the sum of squared residuals, which is -1 if the points lie on a line.
    """
    n = float(s[0])
    mx, my, mz = s[1] / n, s[2] / n, s[3] / n
    xx, xy, yy = s[4] - n * mx * mx, s[5] - n * mx * my, s[6] - n * my * my
    xz, yz, zz = (
        (s[7] - n * mx * mz) * z_ratio,
        (s[8] - n * my * mz) * z_ratio,
        s[9] - n * mz * mz,
    )
    det = xx * yy - xy * xy
    if det <= 1e-6 * xx * yy:
        return 0.0, 0.0, 0.0, -1.0
    a, b = (xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det
    return (
        a,
        b,
        mz * z_ratio - a * mx - b * my,
        max(zz * z_ratio * z_ratio - a * xz - b * yz, 0.0),
    )
