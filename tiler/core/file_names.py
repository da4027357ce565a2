"""Files into which a run writes: names of sheets, from a template like ``{name}_{x}_{y}``, and links.

Nothing is written through a symbolic link. Other users who can write to a folder can make links in it. A write through
such a link would change the file to which it leads, with the rights of the user who runs tiler.
"""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Iterable
from pathlib import Path
from string import Formatter

from tiler.core.products import PRODUCTS
from tiler.errors import ConfigError

DEFAULT = "{name}_{x}_{y}"
DRAWN = "{name}_{sheet}"
"""Template for sheets that the user drew."""
EDGES = ("x", "y", "east", "north")
"""West, south, east and north edge of a sheet, in units of the CRS."""
FIELDS = ("name", *EDGES, *(f"{edge}_km" for edge in EDGES), "sheet")
"""Fields of a template: the product, the edges, the edges in thousands of units, and the name of a drawn sheet."""
LONGEST = 200
"""Maximum length of a name without its suffix, in bytes."""
FORBIDDEN = '/\\:*?"<>|'
"""Characters that some system does not allow in file names, in addition to control
characters."""
_DEVICE = re.compile(r"(?:CON|PRN|AUX|NUL|(?:COM|LPT)[0-9¹²³])\s*(?:\.|$)", re.IGNORECASE)
"""Names that Windows reserves for devices, with any suffix."""


class _Place(float):
    """Coordinate that is written without superfluous zeros if the template has no format: ``2600000``, ``0.5``."""

    def __format__(self, spec: str) -> str:
        return (
            super().__format__(spec) if spec else f"{float(self):.3f}".rstrip("0").rstrip(".")
        )


def sheet_name(
    template: str, product: str, edges: tuple[float, float, float, float], sheet: str = ""
) -> str:
    """Return the file name of a sheet without its suffix.

    Parameters
    ----------
    template : str
        Template that `check_template` accepts.
    product : str
    edges : (west, south, east, north)
        Edges of the sheet, in units of the CRS.
    sheet : str
        Name of a sheet that the user drew.
    """
    field_values = {name: _Place(edge) for name, edge in zip(EDGES, edges, strict=True)}
    field_values |= {f"{name}_km": _Place(edge / 1000) for name, edge in field_values.items()}
    return template.format(name=product, sheet=sheet, **field_values)


def fields_of(template: str) -> list[str]:
    """Return the fields of a template. Raise ValueError if it is not a template."""
    return [field for _, field, _, _ in Formatter().parse(template) if field is not None]


def name_prefix(template: str, product: str) -> str:
    """Return the text at the beginning of the names of all sheets of a product."""
    prefix = ""
    for text, field, _, _ in Formatter().parse(template):
        prefix += text
        if field == "name":
            prefix += product
        elif field is not None:
            break
    return prefix


def product_names(text: str | None) -> dict[str, str]:
    """Return the names of all products in the names of their files.

    Parameters
    ----------
    text : str or None
        Other names of some products, like ``dtm=MNT,dsm=MNS``.

    Raises
    ------
    ConfigError
        The text is not valid, has an unknown product, or gives a name that no file may have or that two products share.
    """
    names = {name: name for name in PRODUCTS}
    for item in () if text is None else text.split(","):
        product, sign, name = (part.strip() for part in item.partition("="))
        if not sign:
            raise ConfigError(f"product_name {text!r} is not valid; give dtm=NAME,dsm=NAME")
        if product not in names:
            raise ConfigError(
                f"product_name {text!r}: no product {product!r}; use {', '.join(PRODUCTS)}"
            )
        wrong = fault_of_name(name) if name else "is empty"
        if len(name.encode()) > LONGEST:
            wrong = f"has more than {LONGEST} bytes"
        if wrong:
            raise ConfigError(f"product_name {text!r}: {name!r} {wrong}; use another name")
        names[product] = name
    every = [folded(name) for name in names.values()]
    for name in names.values():
        if every.count(folded(name)) > 1:
            raise ConfigError(
                f"product_name {text!r}: several products have the name {name!r}; give each its own"
            )
    return names


def check_template(template: str, product: str = "dtm") -> str:
    """Return the template. Raise ConfigError if it does not give valid, different names to the sheets of a product."""
    try:
        unknown = [field for field in fields_of(template) if field not in FIELDS]
        if unknown:
            known = ", ".join(FIELDS)
            raise ConfigError(
                f"sheet_name {template!r}: no field {{{unknown[0]}}}; use {known}"
            )
        names = [
            sheet_name(template, product, (x, y, x + 1000, y + 1000), f"{x}-{y}")
            for x, y in ((0, 0), (1000, 0), (0, 1000))
        ]
    except (ValueError, KeyError, IndexError) as error:
        raise ConfigError(
            f"sheet_name {template!r}: {error}; use a template like {DEFAULT}"
        ) from error
    if len({folded(name) for name in names}) < len(names):
        raise ConfigError(
            f"sheet_name {template!r}: adjacent sheets would have the same name; use a template like {DEFAULT}"
        )
    for name in names:
        wrong = fault_of_name(name)
        if wrong:
            raise ConfigError(
                f"sheet_name {template!r}: {name!r} {wrong}; use a template like {DEFAULT}"
            )
        if len(name.encode()) > LONGEST:
            raise ConfigError(
                f"sheet_name {template!r}: names have more than {LONGEST} bytes; use a shorter template"
            )
    return template


def fault_on_windows(name: str) -> str:
    """Return why Windows does not allow a file name, or an empty text."""
    bad = sorted({c for c in name if c in FORBIDDEN or ord(c) < ord(" ")})
    if bad:
        return f"contains {' '.join(map(repr, bad))}"
    return "is the name of a device on Windows" if _DEVICE.match(name) else ""


def fault_of_name(name: str) -> str:
    """Return why a file may not have a name on some system, or an empty text."""
    fault = fault_on_windows(name)
    if not fault and (name.startswith(".") or name != name.strip() or not name.isprintable()):
        return "begins with a dot, begins or ends with a space, or is not printable"
    return fault


def folded(name: str) -> str:
    """Return a text that is equal for names that are the same on a disk that ignores case and the form of accents."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def validate_distinct_names(template: str, names: Iterable[str]) -> None:
    """Raise ConfigError if two of the names are the same on some disk."""
    seen: set[str] = set()
    for name in names:
        if folded(name) in seen:
            raise ConfigError(
                f"--sheet-name {template}: two sheets would have the name {name}; use more digits"
            )
        seen.add(folded(name))


def link_error(path: Path, option: str = "") -> ConfigError:
    """Return the error for a link through which a command would write."""
    return ConfigError(
        f"{option} {path} is a link, through which tiler does not write; remove the link and run again".strip()
    )


def without_links(path: str, flags: int) -> int:
    """Open a file, but not through a link with its name (an ``opener`` of `open`). Raise OSError for a link."""
    # Windows has no such flag. Its users need a privilege to make links.
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)
