"""Values of `--reclass`, apart from `tiler.core.classes.written_classes`, which explains them but needs numpy."""

from __future__ import annotations

ONLY_GROUND = "ground"
ALL = "all"
