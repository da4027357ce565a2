"""Values of `--reclass`, which `tiler.core.classes.written_classes` describes. This module does not need numpy."""

from __future__ import annotations

ONLY_GROUND = "ground"
ALL = "all"
