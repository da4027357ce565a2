"""Server process that imports the modules that children need, and starts each `ChildProcess` as a fork.

Imports take a second or more, and the server does them once for all children. It ends once it
has no child and no `fork_server_running` is active. It has a single thread, since other threads
would be lost in a fork. Only Linux forks safely with all libraries. On other systems each child
starts without the server.
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
import weakref
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pkgutil import resolve_name
from typing import IO, Any

from tiler.import_path import trusted_path

FORKS = sys.platform == "linux" and hasattr(os, "fork") and hasattr(socket, "send_fds")
"""Whether children are forks of a server on this system, which start in milliseconds."""

SERVES = "fork"
"""Argument that makes `tiler.schedule.guarded` the server."""

_SET_BY_LIBRARIES = "_CURL_CA_BUNDLE"
"""Suffix of the environment variables that rasterio and pyproj set when they are imported."""

_SIZE = 8
"""Size of the length of a request, in bytes."""
_CODE = 8
"""Size of an exit code, in bytes."""

NOT_STARTED = 1 << 16
"""Value in place of the exit code of a child that could not start because memory or processes
ran out."""

_GARBAGE_OBJECTS = 100_000
"""Threshold of the garbage collector. With the default of 700, collection takes a tenth of the
import time."""

_ONE_THREAD = "OPENBLAS_NUM_THREADS"
"""Variable without which numpy's library for linear algebra starts a busy thread per core when
it is loaded."""


def child_environment() -> dict[str, str]:
    """Return the environment of a child, with the import path of this process and one thread for linear algebra."""
    return {_ONE_THREAD: "1", **os.environ, "PYTHONPATH": os.pathsep.join(trusted_path())}


_Child = tuple[int | None, bytes, bytes]
"""Memory limit in bytes, first call, and preparation of a requested child."""


class ForkedChild:
    """Child of the server, with the methods of `subprocess.Popen` that `ChildProcess` uses.

    Attributes
    ----------
    stdin, stdout : binary file
        Pipes to and from the child.
    """

    def __init__(
        self, server: _Server, stdin: IO[bytes], stdout: IO[bytes], line: socket.socket
    ) -> None:
        self.stdin = stdin
        self.stdout = stdout
        self._server = server
        self._line = line

    def kill(self) -> None:
        """Let the server kill the child, since only the server can be sure that the process ID is still the child's."""
        with suppress(OSError):  # The child may have ended.
            self._line.shutdown(socket.SHUT_WR)

    def kill_server(self) -> None:
        """Kill the server, for example because it is stopped. All its children die with it."""
        self._server.process.kill()

    def leave(self) -> None:
        """Let the server kill the child, and do not wait for it, since the server may be importing."""
        for end in (self._line, self.stdin, self.stdout):
            with suppress(OSError):  # Buffered data cannot be written any more.
                end.close()
        _used(self._server, -1)

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end of the child, and return its exit code.

        Raise `subprocess.TimeoutExpired` if the child does not end within ``timeout`` seconds.
        """
        self._line.settimeout(timeout)
        try:
            code = self._line.recv(_CODE)
        except TimeoutError:
            raise subprocess.TimeoutExpired("a forked child", timeout or 0) from None
        except OSError:
            code = b""
        self._line.close()
        _used(self._server, -1)
        if not code:
            return -signal.SIGKILL  # The server was killed, and its children with it.
        return int.from_bytes(code, "little", signed=True)


class _Server:
    """Client side of the server. ``uses`` is the number of its children."""

    def __init__(self, setting: tuple[Any, ...]) -> None:
        self.setting = setting
        self.uses = 0
        self.control_socket, theirs = socket.socketpair()
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-m", "tiler.schedule.guarded", SERVES],
                stdin=theirs.fileno(),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=child_environment(),
            )
        # A stopped server does not notice that this process has ended.
        weakref.finalize(self, self.process.kill)

    def prepare(self, names: Sequence[str]) -> None:
        """Send names of functions to call (see `prepare_children`). Raise OSError if the server has ended."""
        self._ask(names, [])

    def fork(
        self, memory_bytes: int | None, call: bytes, prepare: Callable[[], None] | None
    ) -> ForkedChild:
        """Request a child. Raise OSError if the server has ended."""
        calls, stdin = os.pipe()
        stdout, answers = os.pipe()
        line, theirs = socket.socketpair()
        try:
            self._ask(
                (memory_bytes, call, pickle.dumps(prepare)), [calls, answers, theirs.fileno()]
            )
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
        socket.send_fds(self.control_socket, [len(request).to_bytes(_SIZE, "little")], files)
        self.control_socket.sendall(request)

    def end(self) -> None:
        """End the server, which has no children."""
        self.control_socket.close()
        self.process.kill()
        self.process.wait()


_lock = threading.RLock()
_server: _Server | None = None
_kept = 0


def fork_child(
    memory_bytes: int | None, call: bytes, prepare: Callable[[], None] | None
) -> ForkedChild:
    """Fork a child that may allocate ``memory_bytes``.

    The server first imports the modules that ``call`` needs and calls ``prepare``.
    """
    with _lock:
        server = _current()
        try:
            child = server.fork(memory_bytes, call, prepare)
        except OSError:  # The server has just died.
            server = _current(anew=True)
            child = server.fork(memory_bytes, call, prepare)
        _used(server, 1)
        return child


def _current(anew: bool = False) -> _Server:
    """Return the server for the current environment and folder.

    It is a new one if the old one has ended or has another environment or folder.
    """
    global _server
    environment = {
        n: value for n, value in os.environ.items() if not n.endswith(_SET_BY_LIBRARIES)
    }
    # The setting is without the import path: on a cluster Dask adds folders, from which
    # children do not import.
    setting = (environment, _folder())
    old = _server
    if old is not None and (anew or old.setting != setting or old.process.poll() is not None):
        _server = None
        _used(old, 0)
    _server = _server or _Server(setting)
    return _server


@contextmanager
def fork_server_running() -> Iterator[None]:
    """Keep the server until the end of the block, so that consecutive children share its imports."""
    _keep(1)
    try:
        yield
    finally:
        _keep(-1)


def prepare_children(*steps: Callable[[], object]) -> None:
    """Let the server call functions that prepare children, such as imports, in the background.

    Call this within `fork_server_running`.

    Parameters
    ----------
    *steps : callable
        Functions of modules, called in this order. Between two of them the server forks requested children.
    """
    if FORKS:
        names = [f"{step.__module__}:{step.__qualname__}" for step in steps]
        with _lock, suppress(OSError):
            _current().prepare(names)


def _keep(change: int) -> None:
    global _kept
    with _lock:
        _kept += change
        if _server is not None:
            _used(_server, 0)


def _used(server: _Server, change: int) -> None:
    """Count the children of a server, and end it if it has none and is not kept."""
    global _server
    with _lock:
        server.uses += change
        if server.uses > 0 or (_kept and server is _server):
            return
        if server is _server:
            _server = None
        server.end()


def _folder() -> str:
    try:
        return os.getcwd()
    except FileNotFoundError:  # The folder was removed.
        return ""


def serve(control_socket: socket.socket, answer_calls: Callable[[int | None], None]) -> None:
    """Run the server: fork requested children, kill abandoned children, and report the exit code of each."""
    # Ctrl-C reaches every process, and the client handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ended, wake = socket.socketpair()
    wake.setblocking(False)
    signal.set_wakeup_fd(wake.fileno())
    signal.signal(signal.SIGCHLD, lambda *_: None)
    selector = selectors.DefaultSelector()
    lines: dict[socket.socket, int] = {}
    asked = True
    prepared = deque[str]()
    selector.register(control_socket, selectors.EVENT_READ)
    selector.register(ended, selectors.EVENT_READ)
    gc.set_threshold(_GARBAGE_OBJECTS)
    while asked or lines:
        events = selector.select(0 if prepared else None)
        if prepared and not events:
            # A child that needs the function raises the error again.
            with suppress(BaseException):
                resolve_name(prepared.popleft())()
        for source in [key.fileobj for key, _ in events]:
            if source is ended:
                ended.recv(4096)
            # The client has abandoned this child or has ended.
            elif source is not control_socket:
                selector.unregister(source)
                os.kill(lines[source], signal.SIGKILL)  # type: ignore[index]
            elif (request := _request(control_socket)) is None:
                selector.unregister(control_socket)
                prepared.clear()
                asked = False
            elif not request[1]:
                prepared.extend(request[0])
            else:
                (memory_bytes, call, prepare), files = request
                _import(call, prepare)
                calls, answers, number = files
                line = socket.socket(fileno=number)
                try:
                    pid = os.fork()
                except OSError:
                    _refuse(calls, answers, line)
                    continue
                if pid == 0:
                    selector.close()
                    for other in (control_socket, ended, wake, line, *lines):
                        other.close()
                    _become_child(calls, answers)
                    answer_calls(memory_bytes)
                os.close(calls)
                os.close(answers)
                lines[line] = pid
                selector.register(line, selectors.EVENT_READ)
        for line, pid in list(lines.items()):
            ended_pid, status = os.waitpid(pid, os.WNOHANG)
            if ended_pid:
                _report(line, os.waitstatus_to_exitcode(status))
                with suppress(KeyError):  # The line of a killed child is unregistered already.
                    selector.unregister(line)
                line.close()
                del lines[line]
    os._exit(0)


def _refuse(calls: int, answers: int, line: socket.socket) -> None:
    """Report that a child could not start."""
    os.close(calls)
    os.close(answers)
    _report(line, NOT_STARTED)
    line.close()


def _report(line: socket.socket, code: int) -> None:
    with suppress(OSError):  # The process that waited for the code may have ended.
        line.send(code.to_bytes(_CODE, "little", signed=True))


def _request(control_socket: socket.socket) -> tuple[Any, list[int]] | None:
    """Return a requested child with its two pipes and the socket for its exit code, or names of functions.

    The result is None if the client has ended.
    """
    size, files, _, _ = socket.recv_fds(control_socket, _SIZE, 3)
    if len(size) < _SIZE:
        return None
    request = bytearray()
    length = int.from_bytes(size, "little")
    while len(request) < length:
        part = control_socket.recv(length - len(request))
        if not part:
            return None
        request += part
    return pickle.loads(request), files  # The pickle is from the process that started this one.


def _import(call: bytes, prepare: bytes) -> None:
    """Import the modules of a child's first call and call its preparation, so that all children share both."""
    with suppress(BaseException):  # The child raises the error again.
        pickle.loads(call)
        preparation = pickle.loads(prepare)
        if preparation is not None:
            preparation()
    gc.freeze()  # The collector then does not write to shared memory.


def _become_child(calls: int, answers: int) -> None:
    """Set up a forked child: its pipes, its signal handlers, and its death together with the server."""
    import ctypes

    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    # 1 is PR_SET_PDEATHSIG. No other process could end the child if the server died.
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)
    os.dup2(calls, 0)
    os.dup2(answers, 1)
    os.close(calls)
    os.close(answers)
