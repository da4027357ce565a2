"""Starts the children of `Guard` as forks of one process, which imports what they need before it forks.

So imports, a second of work and more, are done once and not in each child. The process ends with the last child, or
with the last `kept_forking`. It is single: no thread is ever lost in a fork. Linux alone forks safely, whatever
libraries are loaded; elsewhere each child starts by itself.
"""

from __future__ import annotations

import gc
import os
import pickle
import selectors
import signal
import socket
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pkgutil import resolve_name
from typing import IO, Any

from tiler.import_path import trusted_path

FORKS = sys.platform == "linux" and hasattr(os, "fork") and hasattr(socket, "send_fds")
"""Whether children are forks of one process here, which start in milliseconds."""

SERVES = "fork"
"""What tells `tiler.schedule.guarded` to be the server."""

WORKING = (
    "tiler.ingest.sources",
    "tiler.pipeline",
    "ptd.methods.auto.method",
    "scipy.ndimage",
    "tiler.runs.worker:load_kernels",
    "scipy.spatial",
    "scipy.optimize",
    "pyogrio",
)
"""For `prepare_children`: what workers of a run need, by name, as it is of layers above."""

_SET_BY_LIBRARIES = "_CURL_CA_BUNDLE"
"""End of the names of variables that rasterio and pyproj set for themselves when they are imported."""

_SIZE, _CODE = 8, 8
"""Bytes of the length of a request, and of an exit code."""

NOT_STARTED = 1 << 16
"""Instead of the exit code of a child for which the system had no process or no memory left."""

_GARBAGE_OBJECTS = 100_000
"""Imports make few objects that are garbage: looking for it after each 700 is a tenth of their time."""

_ONE_THREAD = "OPENBLAS_NUM_THREADS"
"""The library of linear algebra that comes with numpy starts a thread for each core as it is loaded, which spins."""


def child_environment() -> dict[str, str]:
    """Environment of a child: it imports from where this process does, and is one of several, with a thread each."""
    return {_ONE_THREAD: "1", **os.environ, "PYTHONPATH": os.pathsep.join(trusted_path())}


_Child = tuple[int | None, bytes, bytes]
"""Memory, first call, and preparation of a child that is wanted."""


class ForkedChild:
    """A child of the server, used as one of `subprocess.Popen`.

    Attributes
    ----------
    stdin, stdout : binary file
    """

    def __init__(self, server: _Server, stdin: IO[bytes], stdout: IO[bytes], line: socket.socket) -> None:
        self._server, self.stdin, self.stdout, self._line = server, stdin, stdout, line

    def kill(self) -> None:
        """Have the server kill it: it alone knows that the number is still this child's."""
        with suppress(OSError):  # it ended
            self._line.shutdown(socket.SHUT_WR)

    def leave(self) -> None:
        """Have the server kill it, and do not wait until it has: the server may be importing."""
        for end in (self._line, self.stdin, self.stdout):
            with suppress(OSError):  # what was to be written has no reader any more
                end.close()
        _used(self._server, -1)

    def wait(self, timeout: float | None = None) -> int:
        """Its exit code, as that of `subprocess.Popen`, when it has ended; raises `subprocess.TimeoutExpired`."""
        self._line.settimeout(timeout)
        try:
            code = self._line.recv(_CODE)
        except TimeoutError:
            raise subprocess.TimeoutExpired("a forked child", timeout or 0) from None
        except OSError:
            code = b""
        self._line.close()
        _used(self._server, -1)
        # Nothing comes from a server that was killed, and its children with it.
        return int.from_bytes(code, "little", signed=True) if code else -signal.SIGKILL


class _Server:
    """The process that forks, as its user knows it; ``uses`` counts its children."""

    def __init__(self, setting: tuple[Any, ...]) -> None:
        self.setting, self.uses = setting, 0
        self.door, theirs = socket.socketpair()
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-m", "tiler.schedule.guarded", SERVES],
                stdin=theirs.fileno(),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=child_environment(),
            )

    def prepare(self, names: Sequence[str]) -> None:
        """See `prepare_children`; raises OSError where the server is gone."""
        self._ask(names, [])

    def fork(self, memory_bytes: int | None, call: bytes, prepare: Callable[[], None] | None) -> ForkedChild:
        """Ask for a child; raises OSError where the server is gone."""
        calls, stdin = os.pipe()
        stdout, answers = os.pipe()
        line, theirs = socket.socketpair()
        try:
            self._ask((memory_bytes, call, pickle.dumps(prepare)), [calls, answers, theirs.fileno()])
        except OSError:
            line.close()
            os.close(stdin)
            os.close(stdout)
            raise
        finally:
            theirs.close()
            os.close(calls)
            os.close(answers)
        return ForkedChild(self, os.fdopen(stdin, "wb"), os.fdopen(stdout, "rb"), line)

    def _ask(self, what: _Child | Sequence[str], files: list[int]) -> None:
        request = pickle.dumps(what)
        socket.send_fds(self.door, [len(request).to_bytes(_SIZE, "little")], files)
        self.door.sendall(request)

    def end(self) -> None:
        """End it, whose children are gone."""
        self.door.close()
        self.process.kill()
        self.process.wait()


_lock = threading.RLock()
_server: _Server | None = None
_kept = 0


def fork_child(memory_bytes: int | None, call: bytes, prepare: Callable[[], None] | None) -> ForkedChild:
    """A child that may allocate so much; the modules of its first call are imported, and ``prepare`` called, before."""
    with _lock:
        server = _current()
        try:
            child = server.fork(memory_bytes, call, prepare)
        except OSError:  # it died just now
            server = _current(anew=True)
            child = server.fork(memory_bytes, call, prepare)
        _used(server, 1)
        return child


def _current(anew: bool = False) -> _Server:
    """The server, of this environment and folder; a new one where it is of others, or dead."""
    global _server
    # Not the import path: Dask adds a folder for each worker, which is there for nobody.
    setting = (
        {name: value for name, value in os.environ.items() if not name.endswith(_SET_BY_LIBRARIES)},
        _folder(),
    )
    old = _server
    if old is not None and (anew or old.setting != setting or old.process.poll() is not None):
        _server = None
        _used(old, 0)
    _server = _server or _Server(setting)
    return _server


@contextmanager
def kept_forking() -> Iterator[None]:
    """Keep the server, once it is there, until the end: children that end one after another share what it imported."""
    _keep(1)
    try:
        yield
    finally:
        _keep(-1)


def prepare_children(*names: str) -> None:
    """Within `kept_forking`: what children need is imported now, beside what this process does, when none is wanted.

    Parameters
    ----------
    *names : str
        Modules, or functions of modules to be called (``module:function``), in this order.
    """
    if FORKS:
        with _lock, suppress(OSError):
            _current().prepare(names)


def _keep(change: int) -> None:
    global _kept
    with _lock:
        _kept += change
        if _server is not None:
            _used(_server, 0)


def _used(server: _Server, change: int) -> None:
    """Count the children of a server; one that nobody needs any more ends."""
    global _server
    with _lock:
        server.uses += change
        if server.uses == 0 and not (_kept and server is _server):
            if server is _server:
                _server = None
            server.end()


def _folder() -> str:
    try:
        return os.getcwd()
    except FileNotFoundError:  # it was removed
        return ""


def serve(door: socket.socket, answer_calls: Callable[[int | None], None]) -> None:
    """The server: fork children as they are asked for, kill those that are not wanted, tell how each ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches every process; who asks sees to it
    ended, wake = socket.socketpair()
    wake.setblocking(False)
    signal.set_wakeup_fd(wake.fileno())
    signal.signal(signal.SIGCHLD, lambda *_: None)
    selector, lines, asked = selectors.DefaultSelector(), dict[socket.socket, int](), True
    prepared = deque[str]()
    selector.register(door, selectors.EVENT_READ)
    selector.register(ended, selectors.EVENT_READ)
    gc.set_threshold(_GARBAGE_OBJECTS)
    while asked or lines:
        events = selector.select(0 if prepared else None)
        if prepared and not events:
            _prepare(prepared.popleft())
        for source in [key.fileobj for key, _ in events]:
            if source is ended:
                ended.recv(4096)
            elif source is not door:  # who uses this child does not want it any more, or is gone
                selector.unregister(source)
                os.kill(lines[source], signal.SIGKILL)  # type: ignore[index]
            elif (request := _request(door)) is None:
                selector.unregister(door)
                prepared.clear()
                asked = False
            elif not request[1]:
                prepared.extend(request[0])
            else:
                (memory_bytes, call, prepare), files = request
                _import(call, prepare)
                calls, answers, line = files[0], files[1], socket.socket(fileno=files[2])
                try:
                    pid = os.fork()
                except OSError:
                    _refuse(calls, answers, line)
                    continue
                if pid == 0:
                    selector.close()
                    for other in (door, ended, wake, line, *lines):
                        other.close()
                    _become_child(calls, answers)
                    answer_calls(memory_bytes)
                os.close(calls)
                os.close(answers)
                lines[line] = pid
                selector.register(line, selectors.EVENT_READ)
        for line, pid in list(lines.items()):
            if (status := os.waitpid(pid, os.WNOHANG))[0]:
                _tell(line, os.waitstatus_to_exitcode(status[1]))
                with suppress(KeyError):  # it was killed
                    selector.unregister(line)
                line.close()
                del lines[line]
    os._exit(0)


def _refuse(calls: int, answers: int, line: socket.socket) -> None:
    """Tell who asked for a child that there is none."""
    os.close(calls)
    os.close(answers)
    _tell(line, NOT_STARTED)
    line.close()


def _tell(line: socket.socket, code: int) -> None:
    with suppress(OSError):  # nobody waits for it
        line.send(code.to_bytes(_CODE, "little", signed=True))


def _request(door: socket.socket) -> tuple[Any, list[int]] | None:
    """A child that is wanted, with its pipes and line, or names to be prepared without any; None at the end of all."""
    size, files, _, _ = socket.recv_fds(door, _SIZE, 3)
    if len(size) < _SIZE:
        return None
    request, length = bytearray(), int.from_bytes(size, "little")
    while len(request) < length:
        if not (part := door.recv(length - len(request))):
            return None
        request += part
    return pickle.loads(request), files  # of the process that started this one


def _prepare(name: str) -> None:
    with suppress(BaseException):  # who needs it meets it again, and says so
        found = resolve_name(name)
        if ":" in name:
            found()


def _import(call: bytes, prepare: bytes) -> None:
    """Import what the first call of a child needs, and do what its preparation does, so that children share it."""
    with suppress(BaseException):  # the child meets it again, and says so
        pickle.loads(call)
        if (preparation := pickle.loads(prepare)) is not None:
            preparation()
    gc.freeze()  # what is shared is not written to


def _become_child(calls: int, answers: int) -> None:
    """In a child just forked: its own pipes, no ear for signals of the server, and an end with the server's."""
    import ctypes

    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: nobody else could end it
    os.dup2(calls, 0)
    os.dup2(answers, 1)
    os.close(calls)
    os.close(answers)
