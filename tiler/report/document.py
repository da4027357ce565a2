"""A self-contained HTML file: elements, and the page around them.

Elements are from `xml.etree.ElementTree`, whose serializer escapes every text and attribute, so
that file names and messages cannot become markup. A content security policy forbids the page to
load anything or to run other scripts. A command replaces only a page that it wrote earlier.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote
from xml.etree import ElementTree

from tiler.core.file_names import link_error
from tiler.errors import ConfigError
from tiler.io.overwrite_check import Target, check_targets, is_url_path
from tiler.redaction import shown

MAX_NARROW = 3
"""Number of columns that fit on the screen of a phone."""

Node = ElementTree.Element
Content = Node | str | None


HEAD_BYTES = 8192
"""Bytes at the start of a page in which the name of its command stands."""


def el(tag: str, *children: Content, **attributes: str | int | float) -> Node:
    """Return an element without the children that are None.

    The attribute ``class_`` becomes ``class``, and ``data_x`` becomes ``data-x``.
    """
    names = {
        name.rstrip("_").replace("_", "-"): shown(str(value))
        for name, value in attributes.items()
    }
    node = Node(tag, names)
    for child in children:
        if isinstance(child, Node):
            node.append(child)
        elif child is not None and len(node):
            node[-1].tail = (node[-1].tail or "") + shown(child)
        elif child is not None:
            node.text = (node.text or "") + shown(child)
    return node


def table(
    headings: Sequence[str], rows: Sequence[Sequence[Content]], numbers: Sequence[int] = ()
) -> Node:
    """Return a table whose columns ``numbers`` are aligned right, in a box that scrolls if the table is too wide.

    On narrow screens, each row of more than `MAX_NARROW` columns is a list of its cells with their headings.
    """
    classes = [{"class_": "number"} if i in numbers else {} for i in range(len(headings))]
    head = el(
        "tr", *(el("th", h, scope="col", **c) for h, c in zip(headings, classes, strict=True))
    )
    is_list = len(headings) > MAX_NARROW
    if is_list:
        classes = [{**c, "data_name": h} for c, h in zip(classes, headings, strict=True)]
    body = [
        el("tr", *(el("td", cell, **c) for cell, c in zip(row, classes, strict=True)))
        for row in rows
    ]
    box = "wide list" if is_list else "wide"
    return el("div", el("table", el("thead", head), el("tbody", *body)), class_=box, tabindex=0)


def bar(share: float, width: int = 100) -> Node:
    """Return a horizontal bar for a share of ``width`` pixels, which becomes narrower with its cell."""
    box = f"0 0 {width} 10"
    filled = el("rect", class_="bar", width=f"{max(width * share, share > 0):.1f}", height=10)
    return el(
        "svg",
        filled,
        width=width,
        height=10,
        viewBox=box,
        preserveAspectRatio="none",
        aria_hidden="true",
    )


def swatch(colour: str, text: str) -> Node:
    """Return an entry of a legend: a square of a colour, such as ``#1f78d1``, and a text."""
    box = el("rect", width=12, height=12, fill=colour)
    square = el("svg", box, width=12, height=12, aria_hidden="true")
    return el("span", square, f" {text}", class_="swatch")


def link(path: str) -> Node:
    """Return a link to a file by its path relative to the page."""
    return el("a", path, href=quote(os.fsencode(path)))


def more(number: int, most: int, where: str = "run.json") -> Node | None:
    """Return a line about the entries beyond the most that are shown, or None if all are."""
    return el("p", f"{number - most:,} more are in {where}.") if number > most else None


def facts(pairs: Mapping[str, Content]) -> Node:
    """Return a list of names and values, without values that are None."""
    shown = [(name, value) for name, value in pairs.items() if value is not None]
    return el(
        "dl", *(node for name, value in shown for node in (el("dt", name), el("dd", value)))
    )


def section(name: str, title: str, *children: Content, heading: str = "h2") -> Node:
    """Return a section of the page, to which the list of contents links unless it is part of another."""
    return el(
        "section",
        el(heading, title, id=f"{name}-title"),
        *children,
        id=name,
        aria_labelledby=f"{name}-title",
    )


def page(
    title: str,
    header: Node,
    sections: Sequence[Node],
    data: Mapping[str, Any] | None = None,
    script_names: Sequence[str] = ("page.js",),
    maker: str = "tiler",
) -> bytes:
    """Return the whole file as bytes.

    Parameters
    ----------
    title : str
    header : Element
    sections : sequence of Element
        Sections of `section`.
    data : mapping, optional
        Data for the script of the page, embedded as JSON. A page without data has no script.
    script_names : sequence of str
        Files of the script, one after the other.
    maker : str
        Name of the program, or of the command.

    Returns
    -------
    bytes
        UTF-8.
    """
    assets = files("tiler.report")
    style = (assets / "page.css").read_text("utf-8")
    names = () if data is None else script_names
    script = "".join((assets / name).read_text("utf-8") for name in names)
    allowed = f"'{_digest(script)}'" if script else "'none'"
    policy = (
        f"default-src 'none'; img-src data:; style-src '{_digest(style)}'; script-src {allowed}; "
        "base-uri 'none'; form-action 'none'"
    )
    links = [
        el("a", part[0].text, href=f"#{part.get('id')}")
        for part in sections
        if len(sections) > 1
    ]
    contents = el("nav", *links, aria_label="Contents")
    # Browsers do not unescape the text of a script element, so it must not contain "<".
    embedded = Node("script", {"type": "application/json", "id": "data"})
    embedded.text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace(
        "<", "\\u003c"
    )
    code, look = Node("script"), Node("style")
    code.text, look.text = script, style
    scripted = [embedded, code] if script else []
    root = el(
        "html",
        el(
            "head",
            el("meta", charset="utf-8"),
            el("meta", http_equiv="Content-Security-Policy", content=policy),
            el("meta", name="viewport", content="width=device-width, initial-scale=1"),
            el("meta", name="color-scheme", content="light dark"),
            el("meta", name="referrer", content="no-referrer"),
            el("meta", name="generator", content=maker),
            el("title", title),
            look,
        ),
        el("body", header, contents if links else None, el("main", *sections), *scripted),
        lang="en",
    )
    markup: bytes = ElementTree.tostring(root, encoding="utf-8", method="html")
    return b"<!DOCTYPE html>\n" + markup + b"\n"


def _digest(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")


def validate_page(target: Path, reads: Iterable[str | Path], maker: str) -> None:
    """Raise ConfigError if a page cannot be written, or would replace a file that is not an earlier page.

    Parameters
    ----------
    target : Path
        File that the user gives with ``--page``, or its default.
    reads : iterable of str or Path
        Paths and URLs of all files that the command reads.
    maker : str
        Name of the command, which its pages have in their head (`tiler.report.document.page`).
    """
    if is_url_path(target):
        raise ConfigError(f"--page {target}: is a URL; give a file on this machine")
    check_targets([Target("--page", target, (".html",))], reads)
    if target.is_symlink():
        raise link_error(target, "--page")
    if not target.parent.is_dir():
        raise ConfigError(
            f"--page {target}: its folder does not exist; make it, or give another file"
        )
    if not target.exists():
        return
    try:
        is_earlier = is_page_of(target, maker)
    except OSError as error:
        raise ConfigError(
            f"--page {target}: cannot be read ({error.strerror}); give another file"
        ) from error
    if not is_earlier:
        raise ConfigError(
            f"--page {target}: exists and is not a page of this command; give another file"
        )


def is_page_of(target: Path, maker: str) -> bool:
    """Return whether a file is an earlier page of a command."""
    if not target.is_file():
        return False
    with target.open("rb") as stream:
        return f'content="{maker}"'.encode() in stream.read(HEAD_BYTES)
