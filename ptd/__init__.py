"""Ground filters by progressive TIN densification: arrays in, arrays out.

Vocabulary: a *count* is the integer unit of coordinates (`ptd.frame.Scale` has its length in
metres). A *candidate* is a point that may become a vertex. *Seeds* are the vertices of the
first TIN. A *round* tests all candidates against one TIN and inserts the candidates that pass
the test. A *window* is a rectangle in which all points are known. A decision is *uncertified*
if points beyond the window could change it. A *pass* is a step of a method that runs on every
tile. The next pass may use statistics of the whole run.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ptd.api import Result as Result
    from ptd.api import classify as classify
    from ptd.matched.evidence import Evidence as Evidence

__all__ = ["Evidence", "Result", "classify"]

_HOMES = {"Evidence": "ptd.matched.evidence"}


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used, so that importing a part of the package stays cheap."""
    if name in __all__:
        return getattr(import_module(_HOMES.get(name, "ptd.api")), name)
    raise AttributeError(f"module 'ptd' has no attribute {name!r}")
