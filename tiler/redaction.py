"""Removal of passwords, tokens and control characters from text before it is displayed or stored."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

_USERINFO = re.compile(
    # This finds user and password of `ftp://anna:secret@host`. If the password contains an
    # unescaped / ? # or @, the text after the colon is not a port. `Path` keeps one of the two
    # slashes. In Azure's `abfs://container@account/path`, the text before the @ is a container
    # and stays.
    r"""(?i)(\b(?!(?:abfs|wasb)s?:/+[^\s"'<>/:@]*@)[a-z][a-z0-9+.-]*:/{1,2})(?:[^\s"'<>/?#]*@|[^\s"'<>/?#@:[\]]*:(?!\d*(?:[/?#\s"'<>]|$))[^\s"'<>]*@)"""
)
_QUERY = re.compile(r"""(:/{1,2}[^\s"'<>?]*)\?[^\s"'<>]*[^\s"'<>:;,.)\]}\\]""")
_NAMED_VALUE = re.compile(r"""\?[\w.~%-]+=[^\s"'<>]*[^\s"'<>:;,.)\]}\\]""")
"""Query of a URL whose path contains a space."""
_AUTHORIZATION = re.compile(
    r"""(?i)(\bauthorization['"]?\s*[:=]\s*)(?:"[^"]*"|'[^']*'|(?:\w+ )?[^\s"'<>,;)}\]]+)"""
)
"""Header of a request, as web libraries print it in their errors."""


def without_secrets(text: str) -> str:
    """Return a text without authorization headers, and without user, password and query of URLs.

    A query may contain a token.
    """
    if ":" not in text and "=" not in text:
        return text
    text = _AUTHORIZATION.sub(r"\1...", text)
    if ":/" not in text:
        return text
    return _NAMED_VALUE.sub("", _QUERY.sub(r"\1", _USERINFO.sub(r"\1", text)))


def printable(text: str) -> str:
    """Return a text with escapes for unprintable characters, so that no file name can break, colour or move a line."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def shown(text: str) -> str:
    """Return a text for a line in a terminal, a log or a report: `printable` and `without_secrets`."""
    return printable(without_secrets(text))


def stored(value: Any) -> Any:
    """Return a JSON-able value for a file, with `without_secrets` applied to all its texts and names."""
    if isinstance(value, str):
        return without_secrets(value)
    # Most values are numbers, and the other checks take longer.
    if value is None or isinstance(value, float | int):
        return value
    if isinstance(value, Mapping):
        return {stored(name): stored(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [stored(item) for item in value]
    return value
