"""Paths on servers that a URL names with host and user, which fsspec and universal-pathlib leave out of their names.

Imported where such a URL is used: universal-pathlib need not be installed.
"""

from __future__ import annotations

from typing import Any
from urllib.parse import quote

from upath import UPath
from upath.implementations.ftp import FTPPath
from upath.implementations.sftp import SFTPPath
from upath.implementations.smb import SMBPath
from upath.registry import register_implementation


def _url(path: Any, text: str) -> str:
    """The URL with which a path is opened from anywhere; what is relative stays as it is."""
    options = path.storage_options
    protocol, separator, _ = text.partition("://")
    if not separator or "host" not in options:
        return text
    user, password = (options.get(name) for name in ("username", "password"))
    login = "" if not user else quote(user, "") + (f":{quote(password, '')}" if password else "") + "@"
    port = f":{options['port']}" if options.get("port") else ""
    return f"{protocol}://{login}{options['host']}{port}{path.path}"


class OnFtp(FTPPath):
    """A path on an FTP server."""

    __slots__ = ()

    def __str__(self) -> str:
        return _url(self, super().__str__())


class OnSftp(SFTPPath):
    """A path that is reached by SSH."""

    __slots__ = ()

    def __str__(self) -> str:
        return _url(self, super().__str__())


class OnSmb(SMBPath):
    """A path on a share of Windows."""

    __slots__ = ()

    def __str__(self) -> str:
        return _url(self, super().__str__())


_PATHS: dict[str, type[UPath]] = {"ftp": OnFtp, "sftp": OnSftp, "ssh": OnSftp, "smb": OnSmb}
for _protocol, _class in _PATHS.items():
    register_implementation(_protocol, _class, clobber=True)


def server_path(url: str, **login: str) -> Any:
    """The path of a URL of one of these protocols, with the user and password as they are."""
    return UPath(url, **login)
