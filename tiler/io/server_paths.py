"""Paths on servers (FTP, SSH, SMB) whose text contains host and user, which universal-pathlib leaves out.

This module is imported only if such a URL is used, since universal-pathlib need not be
installed.
"""

from __future__ import annotations

import weakref
from typing import Any
from urllib.parse import quote

import fsspec
from fsspec.implementations.ftp import FTPFileSystem
from upath import UPath
from upath.implementations.ftp import FTPPath
from upath.implementations.sftp import SFTPPath
from upath.implementations.smb import SMBPath
from upath.registry import register_implementation


def _url(path: Any, text: str) -> str:
    """Return the complete URL of a path, or a relative path unchanged."""
    options = path.storage_options
    protocol, separator, _ = text.partition("://")
    if not separator or "host" not in options:
        return text
    server = options["host"]
    if options.get("port"):
        server += f":{options['port']}"
    if options.get("username"):
        login = quote(options["username"], "")
        if options.get("password"):
            login += f":{quote(options['password'], '')}"
        server = f"{login}@{server}"
    return f"{protocol}://{server}{path.path}"


class FtpSystem(FTPFileSystem):  # type: ignore[misc]  # fsspec has no types
    """File system on an FTP server, with connections that are closed at a known time.

    fsspec leaves a connection that it replaces, and a connection with a refused login, to the
    garbage collector. The collector may also delete a socket before the file system that closes
    it.
    """

    _close: weakref.finalize[Any, FtpSystem] | None = None

    def _connect(self) -> None:
        if self._close is not None:
            self._close()
        try:
            super()._connect()
        except BaseException:
            self.ftp.close()
            raise
        self._close = weakref.finalize(self, self.ftp.close)


class OnFtp(FTPPath):
    """Path on an FTP server."""

    __slots__ = ()

    def __str__(self) -> str:
        return _url(self, super().__str__())


class OnSftp(SFTPPath):
    """Path on an SSH server."""

    __slots__ = ()

    def __str__(self) -> str:
        return _url(self, super().__str__())


class OnSmb(SMBPath):
    """Path on a Windows share."""

    __slots__ = ()

    def __str__(self) -> str:
        return _url(self, super().__str__())


fsspec.register_implementation("ftp", FtpSystem, clobber=True)

_PATHS: dict[str, type[UPath]] = {"ftp": OnFtp, "sftp": OnSftp, "ssh": OnSftp, "smb": OnSmb}
for _protocol, _class in _PATHS.items():
    register_implementation(_protocol, _class, clobber=True)


def server_path(url: str, **login: str) -> Any:
    """Return the path of an FTP, SSH or SMB URL. ``login`` is user and password without escapes."""
    return UPath(url, **login)
