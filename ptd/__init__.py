"""Ground filters by progressive TIN densification: arrays in, arrays out.

Vocabulary: a *count* is the integer unit of coordinates (`ptd.frame.Scale` says how many metres); a
*candidate* is a point that may become a vertex; *seeds* are the vertices of the first TIN; a *round* tests all
candidates against one TIN and inserts those that pass; a *window* is where all points are known; a *mark* says
that points beyond the window could change a decision; a *pass* is what a method does to every tile before it
needs run-wide figures.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ptd.api import Result as Result
    from ptd.api import classify as classify

__all__ = ["Result", "classify"]


def __getattr__(name: str) -> Any:
    """Load the wrapper when it is first used: importing a part of the package stays cheap."""
    if name in __all__:
        from ptd import api

        return getattr(api, name)
    raise AttributeError(f"module 'ptd' has no attribute {name!r}")
