"""Exact geometric predicates on integer coordinates whose differences stay below 2**26.

The arguments are the positions of the other points *relative to the query point*, as int64.
Then

- a product of two differences is below 2**52 and the difference of two such products below 2**53: it is
  exact in int64 and in float64;
- the in-circle determinant is the sum of three products of a square sum and a cross product, each factor an
  integer of at most 2**53, hence exact in float64. Only three products and two sums are rounded, so with u
  = 2**-53 the error stays below 4 u S, S the sum of the absolute products. If the float64 value does not
  exceed that bound, the true value stays below 8 u S < 2**58, hence *the same expression in int64, which
  wraps modulo 2**64, is the exact value*. No wide integers are needed.

Sources: the idea of a filter with an error bound is Shewchuk's (Adaptive precision
floating-point arithmetic and fast robust geometric predicates, 1997). The perturbation is that
of Devillers and Teillaud (Perturbations and vertex removal in a 3D Delaunay triangulation, SODA
2003), as "the lexicographically largest point moves most".
"""

from ptd.kernel import as_int64, kernel

_ERROR = 4.0 * 2.0**-53


@kernel
def cross_at(x: int, y: int, ax: int, ay: int, bx: int, by: int) -> int:
    """Orientation of the points (a, b, p) with p = (x, y): positive if p lies to the left of a -> b."""
    return (ax - x) * (by - y) - (ay - y) * (bx - x)


@kernel
def lexicographic_less(ax: int, ay: int, bx: int, by: int) -> bool:
    """Whether a comes before b in the order by x, then y."""
    return ax < bx or (ax == bx and ay < by)


@kernel
def in_circle(ax: int, ay: int, bx: int, by: int, cx: int, cy: int) -> bool:
    """Whether the origin lies inside the circle through the counter-clockwise triangle (a, b, c).

    The symbolic perturbation decides for points on the circle: it raises the lift of the
    lexicographically largest of the four points most. So the answer depends on the four
    positions alone, neither on the order of insertion nor on a translation.

    Parameters
    ----------
    ax, ay, bx, by, cx, cy : int64
        Positions relative to the query point, counts, each below 2**26 in magnitude.
    """
    fax, fay, fbx, fby, fcx, fcy = (
        float(ax),
        float(ay),
        float(bx),
        float(by),
        float(cx),
        float(cy),
    )
    first = (fax * fax + fay * fay) * (fbx * fcy - fby * fcx)
    second = (fbx * fbx + fby * fby) * (fcx * fay - fcy * fax)
    third = (fcx * fcx + fcy * fcy) * (fax * fby - fay * fbx)
    value = first + second + third
    bound = _ERROR * (abs(first) + abs(second) + abs(third))
    if value > bound:
        return True
    if value < -bound:
        return False
    return _in_circle_close(ax, ay, bx, by, cx, cy)


@kernel
def _in_circle_close(ax: int, ay: int, bx: int, by: int, cx: int, cy: int) -> bool:
    """`in_circle` in int64, for determinants too close to zero for float64."""
    exact = (
        (ax * ax + ay * ay) * (bx * cy - by * cx)
        + (bx * bx + by * by) * (cx * ay - cy * ax)
        + (cx * cx + cy * cy) * (ax * by - ay * bx)
    )
    if exact != 0:
        return exact > 0
    # No three of four distinct points on a circle are collinear, so none of the cross products
    # is zero.
    if lexicographic_less(ax, ay, bx, by):
        if lexicographic_less(bx, by, cx, cy):
            return (
                lexicographic_less(as_int64(0), as_int64(0), cx, cy) and ax * by - ay * bx > 0
            )
        return lexicographic_less(as_int64(0), as_int64(0), bx, by) and cx * ay - cy * ax > 0
    if lexicographic_less(ax, ay, cx, cy):
        return lexicographic_less(as_int64(0), as_int64(0), cx, cy) and ax * by - ay * bx > 0
    return lexicographic_less(as_int64(0), as_int64(0), ax, ay) and bx * cy - by * cx > 0


@kernel
def ghost_conflict(ax: int, ay: int, bx: int, by: int) -> bool:
    """Whether the origin lies in the "circle" of the ghost triangle (ghost, a, b).

    This "circle" is the open half-plane to the left of a -> b and the open segment a b.
    """
    area = ax * by - ay * bx
    if area != 0:
        return area > 0
    return ax * bx + ay * by < 0
