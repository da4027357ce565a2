"""Servers of a folder on loopback: HTTP with parts of files and tags, and as much of FTP as fsspec asks for."""

from __future__ import annotations

import contextlib
import http.server
import re
import socket
import socketserver
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

USER, PASSWORD = "anna", "p/w@1"


@contextlib.contextmanager
def _serving(server: socketserver.TCPServer) -> Iterator[str]:
    """The address of a server that works in a thread of its own."""
    with server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        try:
            yield f"127.0.0.1:{server.server_address[1]}"
        finally:
            server.shutdown()
            thread.join()


class _Http(http.server.SimpleHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def __init__(self, *arguments: Any, parts: bool, fault: str, **options: Any) -> None:
        self._parts, self._fault = parts, fault
        super().__init__(*arguments, **options)

    def send_head(self) -> Any:
        if self._fault.isdigit():
            self.send_error(int(self._fault))
            return None
        if self._fault == "broken":
            self.close_connection = True
            return None
        path = Path(self.translate_path(self.path))
        wanted = re.match(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
        if not path.is_file() or not (wanted and self._parts):
            return super().send_head()
        data, first = path.read_bytes(), int(wanted[1])
        part = data[first : int(wanted[2]) + 1]
        if self._fault == "half":
            part = part[: len(part) // 2]
        self.send_response(206)
        self.send_header("Content-Range", f"bytes {first}-{first + len(part) - 1}/{len(data)}")
        self.send_header("Content-Length", str(len(part)))
        self.end_headers()
        self.wfile.write(part)
        return None

    def end_headers(self) -> None:
        path = Path(self.translate_path(self.path))
        if path.is_file():
            self.send_header("ETag", f'"{path.stat().st_mtime_ns:x}-{path.stat().st_ino:x}"')
        super().end_headers()

    def log_message(self, *_: Any) -> None:
        pass


@contextlib.contextmanager
def http_server(folder: Path, parts: bool = True, fault: str = "") -> Iterator[str]:
    """URL of a folder; without ``parts`` each file is given whole alone.

    A ``fault`` is a status that answers each request, ``half`` of the bytes of a part, or ``broken`` connections.
    """

    class Server(http.server.ThreadingHTTPServer):
        daemon_threads = True

        def handle_error(self, *_: Any) -> None:
            """Clients close when they have enough."""

    handler = partial(_Http, directory=str(folder), parts=parts, fault=fault)
    with _serving(Server(("127.0.0.1", 0), handler)) as address:
        yield f"http://{address}"


class _Ftp(socketserver.StreamRequestHandler):
    """RFC 959 and 3659, as far as a client reads."""

    folder: Path

    def handle(self) -> None:
        self.connection.setsockopt(
            socket.SOL_SOCKET, socket.SO_OOBINLINE, 1
        )  # a request to stop comes urgently
        with contextlib.suppress(OSError), socket.create_server(("127.0.0.1", 0)) as listening:
            self._say("220 here")
            user, start = "", 0
            while line := self.rfile.readline().decode().strip():
                command, _, rest = line.partition(" ")
                if command == "PASV":
                    port = listening.getsockname()[1]
                    self._say(f"227 passive (127,0,0,1,{port >> 8},{port & 255})")
                elif command == "USER":
                    user = rest
                    self._say("331 password")
                elif command == "PASS":
                    self._say("230 in" if (user, rest) == (USER, PASSWORD) else "530 not you")
                elif command == "REST":
                    start = int(rest)
                    self._say("350 from there")
                elif command == "RETR":
                    self._send(listening, (self.folder / rest.strip("/")).read_bytes()[start:])
                    start = 0
                elif command == "MLSD" and (self.folder / rest.strip("/")).is_dir():
                    self._send(listening, self._listed(self.folder / rest.strip("/")))
                else:
                    known = {
                        "TYPE": "200 yes",
                        "ABOR": "226 nothing to stop",
                        "QUIT": "221 bye",
                    }
                    self._say(known.get(command, "550 no"))

    def _say(self, line: str) -> None:
        self.wfile.write(f"{line}\r\n".encode())

    def _listed(self, folder: Path) -> bytes:
        lines = []
        for path in sorted(folder.iterdir()):
            kind, stat = "dir" if path.is_dir() else "file", path.stat()
            lines.append(
                f"type={kind};size={stat.st_size};modify=20260101000000; {path.name}\r\n"
            )
        return "".join(lines).encode()

    def _send(self, listening: socket.socket, data: bytes) -> None:
        self._say("150 coming")
        connection, _ = listening.accept()
        try:
            with connection:
                connection.sendall(data)
        except OSError:  # the client has enough
            self._say("426 stopped")
        else:
            self._say("226 that was it")


@contextlib.contextmanager
def ftp_server(folder: Path) -> Iterator[str]:
    """URL of a folder, with user and password as they stand in URLs."""

    class Server(socketserver.ThreadingTCPServer):
        daemon_threads = True

    handler = type("Handler", (_Ftp,), {"folder": folder})
    with _serving(Server(("127.0.0.1", 0), handler)) as address:
        yield f"ftp://{USER}:p%2Fw%401@{address}"


@contextlib.contextmanager
def stalling_server(parts: int = 0) -> Iterator[str]:
    """URL below which each file has a size, but a request for one gets headers and ``parts`` bytes, ten a second."""
    ended = threading.Event()

    class Handler(http.server.BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_HEAD(self) -> None:
            self.send_response(200)
            self.send_header("Content-Length", "1000")
            self.end_headers()

        def do_GET(self) -> None:
            self.do_HEAD()
            for _ in range(parts):
                self.wfile.write(b" ")
                ended.wait(0.1)
            ended.wait()

        def log_message(self, *_: Any) -> None:
            pass

    class Server(http.server.ThreadingHTTPServer):
        daemon_threads = True

        def handle_error(self, *_: Any) -> None:
            """Clients close when they have waited enough."""

    with _serving(Server(("127.0.0.1", 0), Handler)) as address:
        try:
            yield f"http://{address}"
        finally:
            ended.set()
