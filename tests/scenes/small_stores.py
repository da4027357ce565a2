"""Stores for small scenes: dozens of buckets, and rows that are not mostly padding, a third of the cost of a run."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tiler.store import layout

USUAL_ROW_POINTS = layout.ROW_POINTS


def small_stores(
    patch: pytest.MonkeyPatch, bucket_points: int = 1000, row_points: int = 1024
) -> None:
    """Let new stores have buckets (32 m for 1000 points at one a square metre) and rows of about so many points.

    Neither changes a result. Rows are known to this process alone: workers need the usual.
    """
    patch.setattr("tiler.plan.sizes.BUCKET_POINTS", bucket_points)
    for module in ("layout", "points"):
        patch.setattr(f"tiler.store.{module}.ROW_POINTS", row_points)

    def short(kind: layout.ArrayKind) -> layout.ArrayKind:
        return replace(kind, chunks=(*kind.chunks[:2], row_points // kind.pieces))

    for name in ("LABELS", "ELECTED"):
        patch.setattr(layout, name, short(getattr(layout, name)))
    columns = tuple(
        layout.Column(c.name, c.fields, c.width, short(c.kind)) for c in layout.COLUMNS
    )
    patch.setattr(layout, "COLUMNS", columns)
