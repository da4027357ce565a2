"""Removes passwords, tokens and control characters from text before it is shown or stored."""

from __future__ import annotations

import re
from typing import Any

_USERINFO = re.compile(
    # User and password of `ftp://anna:secret@host`. If the password holds an unescaped / ? # or @, the text after the
    # colon is not a port. `Path` leaves one slash of the two. In Azure's `abfs://container@account/path`, the text
    # before the @ is a container and stays.
    r"""(?i)(\b(?!(?:abfs|wasb)s?:/+[^\s"'<>/:@]*@)[a-z][a-z0-9+.-]*:/{1,2})(?:[^\s"'<>/?#]*@|[^\s"'<>/?#@:[\]]*:(?!\d*(?:[/?#\s"'<>]|$))[^\s"'<>]*@)"""
)
_QUERY = re.compile(r"""(:/{1,2}[^\s"'<>?]*)\?[^\s"'<>]*[^\s"'<>:;,.)\]}\\]""")
_NAMED_VALUE = re.compile(r"""\?[\w.~%-]+=[^\s"'<>]*[^\s"'<>:;,.)\]}\\]""")
"""The query of a URL whose path holds a space."""
_AUTHORIZATION = re.compile(
    r"""(?i)(\bauthorization['"]?\s*[:=]\s*)(?:"[^"]*"|'[^']*'|(?:\w+ )?[^\s"'<>,;)}\]]+)"""
)
"""A header of a request, as libraries for the web print it in their errors."""


def without_secrets(text: str) -> str:
    """The text without user, password and query (which may hold a token) of URLs, and without authorization headers."""
    if ":" not in text and "=" not in text:
        return text
    text = _AUTHORIZATION.sub(r"\1...", text)
    if ":/" not in text:
        return text
    return _NAMED_VALUE.sub("", _QUERY.sub(r"\1", _USERINFO.sub(r"\1", text)))


def printable(text: str) -> str:
    """The text with escapes for what is not printable, so that no file name can break, colour or move a line."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def shown(text: str) -> str:
    """The text for a line in a terminal, a log or a report: `printable` and `without_secrets`."""
    return printable(without_secrets(text))


def stored(value: Any) -> Any:
    """A JSON-able value for a file: `without_secrets` is applied to all its texts and names."""
    if isinstance(value, str):
        return without_secrets(value)
    if isinstance(value, dict):
        return {stored(name): stored(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [stored(item) for item in value]
    return value
