"""Locks that allow one run per store and per folder of results: leases that a live run renews."""

from __future__ import annotations

import os
import socket
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import psutil

from tiler.errors import LockedError, StoreError, TilerError
from tiler.io.atomic_files import SCRATCH_PREFIX
from tiler.store.layout import LOCK_KEY
from tiler.store.storage import Storage

LEASE_SECONDS = 120.0
"""Time in seconds since its last renewal after which a lease of another host seems to be
abandoned."""
RENEW_SECONDS = 20.0
OBSERVE_SECONDS = 1.5 * RENEW_SECONDS
"""Time to watch a lease that seems to be abandoned, since the clock of the other host may
differ."""
DAMAGED = "?"
"""Host name of the `Holder` that stands for a lease that cannot be read."""
FOLDER_LOCK = f"{SCRATCH_PREFIX}lock.json"
"""Name of the lease in a folder of results."""
SETTLE_SECONDS = 0.5
"""Time until a new lease is read again if two writers can both succeed: the last writer holds the lease.

Two writers can both succeed on object stores through fsspec and on disks without hard links."""


@dataclass(frozen=True)
class Holder:
    """Run that holds a lease, as the lease describes it.

    ``started`` is the start of the process (see `_start_of`). ``since`` and ``renewed`` are the Unix times at which the
    lease was taken and last renewed.
    """

    token: str
    host: str
    pid: int
    started: float | None
    since: float
    renewed: float
    boot: str = ""
    pid_namespace: str = ""


class Lease:
    """Lease that this process holds. Call `check` before anything that only the holder may do."""

    def __init__(self, storage: Storage, key: str) -> None:
        self._storage = storage
        self._key = key
        self._token = uuid.uuid4().hex
        self._stop = threading.Event()
        self._since = time.time()

    def check(self) -> None:
        """Raise LockedError if another run took over the lease, which can happen while this machine sleeps."""
        holder = _holder(self._storage, self._key)
        if holder is None or holder.token != self._token:
            raise _refused(self._storage, holder)

    def _this_holder(self) -> Holder:
        pid = os.getpid()
        return Holder(
            token=self._token,
            pid=pid,
            started=_start_of(pid),
            since=self._since,
            renewed=time.time(),
            **_here(),
        )

    def _renew(self) -> None:
        while not self._stop.wait(RENEW_SECONDS):
            try:
                self.check()
                self._storage.put_json(self._key, asdict(self._this_holder()))
            except LockedError:
                return  # The next `check` of the run raises the error again.
            except (TilerError, OSError):
                # The fault may be temporary, and the lease remains valid even if several
                # renewals fail.
                continue

    def _acquire(self) -> None:
        holder = _holder(self._storage, self._key)
        taken_over = holder is not None
        if holder is not None:
            if not _stale(self._storage, self._key, holder):
                raise _refused(self._storage, holder)
            self._storage.delete(self._key)
        exclusive = self._storage.put_json_new(self._key, asdict(self._this_holder()))
        if taken_over or not exclusive:
            time.sleep(SETTLE_SECONDS)
        self.check()

    def _release(self) -> None:
        holder = _holder(self._storage, self._key)
        if holder is not None and holder.token == self._token:
            self._storage.delete(self._key)


@contextmanager
def locked(storage: Storage, key: str = LOCK_KEY) -> Iterator[Lease]:
    """Hold a lock of a store or folder during the block.

    Three kinds of lease are taken over: one that cannot be read, one whose process ran on this
    machine and has ended, and one that was not renewed for `LEASE_SECONDS` by this clock and is
    not renewed during `OBSERVE_SECONDS`.

    Raises
    ------
    LockedError
        Another run holds the lock. The message names that run.
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
    """Hold the lock of a folder of results, given as path or URL. Raise LockedError if another run holds it."""
    return locked(Storage(place), FOLDER_LOCK)


def validate_not_held(storage: Storage) -> None:
    """Raise LockedError if a run of another process holds the store."""
    holder = _holder(storage, LOCK_KEY)
    if holder is None or _stale(storage, LOCK_KEY, holder):
        return
    if _is_here(holder) and holder.pid == os.getpid():
        return
    raise _refused(storage, holder)


def is_foreign(storage: Storage) -> bool:
    """Return whether the object with the name of a lease is not a lease.

    A lease is written in one piece, so an object that cannot be read is not a damaged lease.
    """
    holder = _holder(storage, LOCK_KEY)
    return holder is not None and holder.host == DAMAGED


def _holder(storage: Storage, key: str) -> Holder | None:
    try:
        body = storage.get_json(key)
    except StoreError:
        return Holder(token="", host=DAMAGED, pid=0, started=0.0, since=0.0, renewed=0.0)
    if body is None:
        return None
    known = {field.name for field in fields(Holder)}
    return Holder(**{name: value for name, value in body.items() if name in known})


def _here() -> dict[str, str]:
    """Return the identity of this machine and of its process table.

    The host name is not enough: two machines may share it, and so may the containers of a
    machine, each with its own process table. The identities of the boot and of the process
    table are empty if the system has none.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        processes = os.readlink("/proc/self/ns/pid")
    except OSError:
        boot = processes = ""
    return {"host": socket.gethostname(), "boot": boot, "pid_namespace": processes}


def _is_here(holder: Holder) -> bool:
    """Return whether a holder runs, or ran, in the process table of this process."""
    return all(getattr(holder, name) == value for name, value in _here().items())


def _refused(storage: Storage, holder: Holder | None) -> LockedError:
    ends = ""
    if holder is not None and not _is_here(holder):
        ends = f"; if it was killed, its lease ends {LEASE_SECONDS:.0f} s after it was last renewed"
    return LockedError(
        f"{storage.url}: in use by {_name(holder)}; wait for it, or stop it{ends}"
    )


def _stale(storage: Storage, key: str, holder: Holder) -> bool:
    """Return whether the holder of a lease has ended. Clocks are not enough to decide it: they jump and differ."""
    if _is_here(holder):
        # Another process may have the same number by now, so the start is compared as well.
        return _start_of(holder.pid) != holder.started
    if holder.host == DAMAGED:
        return True
    if abs(time.time() - holder.renewed) < LEASE_SECONDS:
        return False
    time.sleep(OBSERVE_SECONDS)
    after = _holder(storage, key)
    return after is None or (after.token, after.renewed) == (holder.token, holder.renewed)


def _start_of(pid: int) -> float | None:
    """Return the start of a process, or None if the process does not exist.

    The start is measured with a clock that never jumps if the system has one.
    """
    try:
        # psutil adds these ticks to the time of the boot, so its result jumps with the clock of
        # the machine.
        after_name = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2]
        return float(after_name.split()[19])
    except (FileNotFoundError, ProcessLookupError):
        # ProcessLookupError is raised if the process ends during the read.
        if Path("/proc/self/stat").exists():
            return None
    try:
        return psutil.Process(pid).create_time()
    except psutil.NoSuchProcess:
        return None


def _name(holder: Holder | None) -> str:
    if holder is None:
        return "a process that deleted the lease"
    since = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(holder.since))
    return f"process {holder.pid} on {holder.host} since {since}"
