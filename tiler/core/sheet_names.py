"""Names of the files of sheets, from a template like ``{name}_{x}_{y}``."""

from __future__ import annotations

from collections.abc import Iterable
from string import Formatter

from tiler.errors import ConfigError

DEFAULT = "{name}_{x}_{y}"
EDGES = ("x", "y", "east", "north")
"""West, south, east and north edge of a sheet, in units of the CRS."""
FIELDS = ("name", *EDGES, *(f"{edge}_km" for edge in EDGES))
"""Fields of a template: the product, the edges, and the edges in thousands of units."""
LONGEST = 200
"""Most bytes of a name without its ending."""
FORBIDDEN = '/\\:*?"<>|'
"""Characters that some system does not allow in the name of a file, besides control characters."""


class _Place(float):
    """A coordinate that is written without superfluous zeros if the template gives no format: ``2600000``, ``0.5``."""

    def __format__(self, spec: str) -> str:
        return super().__format__(spec) if spec else f"{float(self):.3f}".rstrip("0").rstrip(".")


def sheet_name(template: str, product: str, x: float, y: float, side: float) -> str:
    """The name of a sheet's file without its ending.

    Parameters
    ----------
    template : str
        A template that `check_template` accepts.
    product : str
    x, y : float
        The south-west corner.
    side : float
    """
    edges = dict(zip(EDGES, (x, y, x + side, y + side), strict=True))
    places = {name: _Place(edge) for name, edge in edges.items()}
    places |= {f"{name}_km": _Place(edge / 1000) for name, edge in edges.items()}
    return template.format(name=product, **places)


def beginning(template: str, product: str) -> str:
    """The text with which the names of all sheets of a product begin."""
    found = ""
    for text, field, _, _ in Formatter().parse(template):
        found += text
        if field == "name":
            found += product
        elif field is not None:
            break
    return found


def check_template(template: str) -> str:
    """The template; raises ConfigError if it cannot name sheets."""
    try:
        fields = [field for _, field, _, _ in Formatter().parse(template) if field is not None]
        unknown = [field for field in fields if field not in FIELDS]
        if unknown:
            known = ", ".join(FIELDS)
            raise ConfigError(f"sheet_name {template!r}: no field {{{unknown[0]}}}; there are {known}")
        names = [sheet_name(template, "dtm", *place, 1000.0) for place in ((0, 0), (1000, 0), (0, 1000))]
    except (ValueError, KeyError, IndexError) as error:
        raise ConfigError(f"sheet_name {template!r}: {error}; write one like {DEFAULT}") from error
    if len({name.lower() for name in names}) < len(names):
        raise ConfigError(
            f"sheet_name {template!r}: sheets side by side would have one name; write one like {DEFAULT}"
        )
    for name in names:
        wrong = _wrong_with(name)
        if wrong:
            raise ConfigError(f"sheet_name {template!r}: {name!r} {wrong}; write one like {DEFAULT}")
        if len(name.encode()) > LONGEST:
            raise ConfigError(f"sheet_name {template!r}: more than {LONGEST} bytes; write a shorter one")
    return template


def _wrong_with(name: str) -> str:
    bad = sorted({c for c in name if c in FORBIDDEN or ord(c) < ord(" ")})
    if bad:
        return f"holds {' '.join(map(repr, bad))}"
    if name.startswith(".") or name != name.strip() or not name.isprintable():
        return "begins or ends as no name of a file should"
    return ""


def refuse_alike(template: str, names: Iterable[str]) -> None:
    """Raise ConfigError if two of the names are the same on a disk that ignores case."""
    seen: set[str] = set()
    for name in names:
        if name.lower() in seen:
            raise ConfigError(
                f"--sheet-name {template}: two sheets would be {name}; write more digits into it"
            )
        seen.add(name.lower())
