"""One run per store, and per folder of results: a lease, renewed while the run lives."""

from __future__ import annotations

import os
import socket
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import psutil

from tiler.errors import LockedError, StoreError, TilerError
from tiler.io.partial_files import SCRATCH_PREFIX
from tiler.store.layout import LOCK_KEY
from tiler.store.storage import Storage

LEASE_SECONDS = 120.0
RENEW_SECONDS = 20.0
OBSERVE_SECONDS = 1.5 * RENEW_SECONDS
"""A lease of another host that seems old is watched for so long: its clock may be another one's."""
DAMAGED = "?"
FOLDER_LOCK = f"{SCRATCH_PREFIX}lock.json"
"""Name of the lease in a folder of results."""
SETTLE_SECONDS = 0.5
"""Where nothing is written exclusively (object stores through fsspec, disks without hard links), the last of two
writers holds the lease after this time."""


class Lease:
    """The lock while it is held; `check` before anything that only its holder may do."""

    def __init__(self, storage: Storage, key: str) -> None:
        self._storage, self._key = storage, key
        self._token = uuid.uuid4().hex
        self._stop = threading.Event()
        self._since = time.time()

    def check(self) -> None:
        """Raise LockedError if another run took the store over, as after a long sleep of this machine."""
        holder = _holder(self._storage, self._key)
        if holder is None or holder["token"] != self._token:
            raise _refused(self._storage, holder)

    def _body(self) -> dict[str, Any]:
        process = psutil.Process()
        return {
            "token": self._token, **_here(), "pid": process.pid, "started": _start_of(process.pid),
            "since": self._since, "renewed": time.time(),
        }  # fmt: skip

    def _renew(self) -> None:
        while not self._stop.wait(RENEW_SECONDS):
            try:
                self.check()
                self._storage.put_json(self._key, self._body())
            except LockedError:
                return  # the holder's own `check` says so
            except (TilerError, OSError):
                continue  # a passing fault of the storage: the lease outlives some of them

    def _acquire(self) -> None:
        holder = _holder(self._storage, self._key)
        taken_over = holder is not None
        if holder is not None:
            if not _stale(self._storage, self._key, holder):
                raise _refused(self._storage, holder)
            self._storage.delete(self._key)
        exclusive = self._storage.put_json_new(self._key, self._body())
        if taken_over or not exclusive:
            time.sleep(SETTLE_SECONDS)
        self.check()

    def _release(self) -> None:
        holder = _holder(self._storage, self._key)
        if holder is not None and holder["token"] == self._token:
            self._storage.delete(self._key)


@contextmanager
def locked(storage: Storage, key: str = LOCK_KEY) -> Iterator[Lease]:
    """Hold the store; raises LockedError, naming the holder, while another run does.

    A lease whose process is gone from this machine, or that seems older than `LEASE_SECONDS` and is not renewed while
    it is watched, is taken over.
    """
    lease = Lease(storage, key)
    lease._acquire()
    renewing = threading.Thread(target=lease._renew, name="tiler-lease", daemon=True)
    renewing.start()
    try:
        yield lease
    finally:
        lease._stop.set()
        renewing.join()
        lease._release()


def locked_folder(place: str) -> AbstractContextManager[Lease]:
    """Hold a folder of results, by path or URL, for one run; raises LockedError while another run does."""
    return locked(Storage(place), FOLDER_LOCK)


def refuse_if_held(storage: Storage) -> None:
    """Raise LockedError while a run of another process holds the store."""
    holder = _holder(storage, LOCK_KEY)
    if holder is not None and not _stale(storage, LOCK_KEY, holder):
        if _is_here(holder) and holder["pid"] == os.getpid():
            return
        raise _refused(storage, holder)


def is_foreign(storage: Storage) -> bool:
    """Whether the object with the name of a lease is something else; leases appear whole, so none is damaged."""
    holder = _holder(storage, LOCK_KEY)
    return holder is not None and holder["host"] == DAMAGED


def _holder(storage: Storage, key: str) -> dict[str, Any] | None:
    try:
        holder: dict[str, Any] | None = storage.get_json(key)
    except StoreError:
        return {"token": "", "host": DAMAGED, "pid": 0, "started": 0.0, "since": 0.0, "renewed": 0.0}
    return holder


def _here() -> dict[str, str]:
    """Identity of this machine and of its table of processes.

    Containers of one machine may share a name but not their processes, and machines may share a name. A boot has an
    identity, and so have the tables of processes of one boot; empty where the system has none.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        processes = os.readlink("/proc/self/ns/pid")
    except OSError:
        boot = processes = ""
    return {"host": socket.gethostname(), "boot": boot, "pid_namespace": processes}


def _is_here(holder: dict[str, Any]) -> bool:
    """Whether the number of a holder's process means here what it meant to the holder."""
    return all(holder.get(name) == value for name, value in _here().items())


def _refused(storage: Storage, holder: dict[str, Any] | None) -> LockedError:
    ends = ""
    if holder is not None and not _is_here(holder):
        ends = f"; if it was killed, its lease ends {LEASE_SECONDS:.0f} s after it was last renewed"
    return LockedError(f"{storage.url}: in use by {_name(holder)}; wait for it, or stop it{ends}")


def _stale(storage: Storage, key: str, holder: dict[str, Any]) -> bool:
    """Whether the holder of a lease is gone. Clocks jump and differ, so they alone never say so."""
    if _is_here(holder):
        # A number alone may have gone to another process since.
        return bool(_start_of(holder["pid"]) != holder["started"])
    if holder["host"] == DAMAGED:
        return True
    if abs(time.time() - holder["renewed"]) < LEASE_SECONDS:
        return False
    time.sleep(OBSERVE_SECONDS)
    after = _holder(storage, key)
    return after is None or (after["token"], after["renewed"]) == (holder["token"], holder["renewed"])


def _start_of(pid: int) -> float | None:
    """When a process started, by a clock that never jumps where there is one; None: there is no such process."""
    try:
        # psutil's time of creation moves with the clock of the wall: it is the time of the boot, and these ticks.
        after_name = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2]
        return float(after_name.split()[19])
    except (FileNotFoundError, ProcessLookupError):  # the latter where it ends while it is read
        if Path("/proc/self/stat").exists():
            return None
    try:
        return psutil.Process(pid).create_time()
    except psutil.NoSuchProcess:
        return None


def _name(holder: dict[str, Any] | None) -> str:
    if holder is None:
        return "somebody who deleted the lease"
    since = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(holder["since"]))
    return f"process {holder['pid']} on {holder['host']} since {since}"
