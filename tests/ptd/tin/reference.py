"""A slow and obvious exact Delaunay triangulation by definition, in Python integers and fractions."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations

Point = tuple[int, int]
Facet = tuple[Point, Point, Point]


def area(a: Point, b: Point, c: Point) -> int:
    """Twice the signed area."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def in_circle(a: Point, b: Point, c: Point, p: Point) -> bool:
    """Whether p lies in the circle of the counter-clockwise a, b, c; on it, the largest of the four is lifted most."""
    rows = [(q[0] - p[0], q[1] - p[1]) for q in (a, b, c)]
    (ax, ay), (bx, by), (cx, cy) = rows
    a2, b2, c2 = (x * x + y * y for x, y in rows)
    value = a2 * (bx * cy - by * cx) + b2 * (cx * ay - cy * ax) + c2 * (ax * by - ay * bx)
    if value:
        return value > 0
    largest = max(a, b, c, p)
    # Raising the lift of p puts it outside; raising the lift of a corner puts p inside if p
    # sees the opposite edge from the same side as that corner does.
    return largest != p and area(*(p if q == largest else q for q in (a, b, c))) > 0


def delaunay(points: list[Point]) -> list[Facet]:
    """Facets with an empty circle, counter-clockwise from their smallest vertex, sorted."""
    distinct = sorted(set(points))
    facets = []
    for a, b, c in combinations(distinct, 3):
        side = area(a, b, c)
        if side == 0:
            continue
        facet = (a, b, c) if side > 0 else (a, c, b)
        if not any(in_circle(*facet, p) for p in distinct if p not in facet):
            facets.append(facet)
    return sorted(facets)


def hull_area(points: list[Point]) -> int:
    """Twice the area of the convex hull (Andrew's monotone chain)."""
    distinct = sorted(set(points))
    if len(distinct) < 3:
        return 0

    def chain(order: list[Point]) -> list[Point]:
        out: list[Point] = []
        for p in order:
            while len(out) > 1 and area(out[-2], out[-1], p) <= 0:
                out.pop()
            out.append(p)
        return out

    ring = chain(distinct)[:-1] + chain(distinct[::-1])[:-1]
    return sum(area(ring[0], ring[i], ring[i + 1]) for i in range(1, len(ring) - 1))


def plane(facet: Facet, z: dict[Point, int], x: Fraction, y: Fraction) -> Fraction:
    """Exact height of the plane of a facet."""
    (ax, ay), (bx, by), (cx, cy) = facet
    az, bz, cz = (z[p] for p in facet)
    u, v = x - ax, y - ay
    total = Fraction(area(*facet))
    along_b = (u * (cy - ay) - v * (cx - ax)) / total
    along_c = (v * (bx - ax) - u * (by - ay)) / total
    return az + along_b * (bz - az) + along_c * (cz - az)
