"""Words for texts that users read: numbers with their nouns, lists, names of CRS."""

from __future__ import annotations

from collections.abc import Sequence


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """Return a number and its noun, like ``1 lake`` or ``2 lakes``. The default plural has an ``s``."""
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {plural or noun + 's'}"


def listed(texts: Sequence[str], limit: int, noun: str = "") -> str:
    """Return the first texts separated by commas, and the number of the others, like ``a, b and 3 more files``.

    Parameters
    ----------
    texts : sequence of str
    limit : int
        Maximum number of texts.
    noun : str
        Plural of the noun after ``more``.
    """
    first = ", ".join(texts[:limit])
    if len(texts) <= limit:
        return first
    return f"{first} and {len(texts) - limit:,} more {noun}".rstrip()


def name_in_wkt(wkt: str | None, none: str = "unknown") -> str:
    """Return the name at the beginning of a CRS in WKT, or the text ``none`` if there is no CRS."""
    if wkt is None:
        return none
    return wkt.split('"', 2)[1] if wkt.count('"') > 1 else wkt
