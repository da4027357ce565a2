"""Removes passwords, tokens and control characters from text before it is shown or stored."""

from __future__ import annotations

import re
from typing import Any

_USERINFO = re.compile(
    # `ftp://anna:secret@host`; with an unescaped / ? # or @ in the password too, as what then follows the colon is no
    # port. One slash: what `Path` makes of a URL. What stands before the @ in `abfs://container@account/path`
    # of Azure's is the container.
    r"""(?i)(\b(?!(?:abfs|wasb)s?:/+[^\s"'<>/:@]*@)[a-z][a-z0-9+.-]*:/{1,2})(?:[^\s"'<>/?#]*@|[^\s"'<>/?#@:[\]]*:(?!\d*(?:[/?#\s"'<>]|$))[^\s"'<>]*@)"""
)
_QUERY = re.compile(r"""(:/{1,2}[^\s"'<>?]*)\?[^\s"'<>]*[^\s"'<>:;,.)\]}\\]""")
_NAMED_VALUE = re.compile(r"""\?[\w.~%-]+=[^\s"'<>]*[^\s"'<>:;,.)\]}\\]""")
"""The query of a URL whose path holds a space."""
_AUTHORIZATION = re.compile(
    r"""(?i)(\bauthorization['"]?\s*[:=]\s*)(?:"[^"]*"|'[^']*'|(?:\w+ )?[^\s"'<>,;)}\]]+)"""
)
"""A header of a request, which libraries for the web print in their errors."""


def without_secrets(text: str) -> str:
    """The text without the user, password and query of its URLs, where tokens stand, nor the login of its requests."""
    text = _AUTHORIZATION.sub(r"\1...", text)
    if ":/" not in text:
        return text
    return _NAMED_VALUE.sub("", _QUERY.sub(r"\1", _USERINFO.sub(r"\1", text)))


def printable(text: str) -> str:
    """The text in one line that no file name can break, colour or move: what is not printable is written as escapes."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def shown(text: str) -> str:
    """One line for a terminal, a log or a report: `without_secrets`, and `printable`."""
    return printable(without_secrets(text))


def stored(value: Any) -> Any:
    """A JSON-able value with `without_secrets` done to all its texts, names too: what a file may keep."""
    if isinstance(value, str):
        return without_secrets(value)
    if isinstance(value, dict):
        return {stored(name): stored(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [stored(item) for item in value]
    return value
