"""One run per store."""

from __future__ import annotations

import errno
import os
import re
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import psutil
import pytest

from tests.waiting import wait_until
from tiler.errors import LockedError
from tiler.store import (
    StoreMeta,
    TileStore,
    create_store,
    lock,
    locked_folder,
    open_store,
    remove_store,
)
from tiler.store.layout import LOCK_KEY
from tiler.store.storage import Storage

REPOSITORY = Path(__file__).resolve().parents[3]


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "SETTLE_SECONDS", 0.02)
    monkeypatch.setattr(lock, "OBSERVE_SECONDS", 0.2)


def lease(**changes: Any) -> dict[str, Any]:
    me = psutil.Process()
    now = time.time()
    started = lock._start_of(me.pid)
    body = {
        "token": "x",
        **lock._here(),
        "pid": me.pid,
        "started": started,
        "since": now,
        "renewed": now,
    }
    return {**body, **changes}


def test_the_lock_refuses_a_second_run_and_names_the_holder(store: TileStore) -> None:
    with store.lock() as held:
        held.check()
        holder = rf"in use by process {os.getpid()} on {socket.gethostname()}"
        with pytest.raises(LockedError, match=holder), open_store(store.url).lock():
            pass
        held.check()
    assert Storage(store.url).get(LOCK_KEY) is None
    with pytest.raises(ZeroDivisionError), store.lock():
        _ = 1 / 0
    with store.lock():
        pass


@pytest.mark.processes
@pytest.mark.parametrize(
    "changes",
    [
        {"renewed": time.time() - 1000, "host": "elsewhere"},
        {"renewed": time.time() + 10**8, "host": "elsewhere"},
        {"pid": 2**22 + 1},
        {"started": 1.0},
    ],
    ids=["not renewed", "from the future", "no such process", "number of another process"],
)
def test_a_stale_lease_is_taken_over(store: TileStore, changes: dict[str, Any]) -> None:
    Storage(store.url).put_json(LOCK_KEY, lease(**changes))
    with store.lock() as held:
        held.check()


def test_a_damaged_lease_is_taken_over(store: TileStore) -> None:
    Storage(store.url).put(LOCK_KEY, b'{"crc')
    with store.lock() as held:
        held.check()


@pytest.mark.processes
def test_a_fresh_lease_of_another_host_holds(store: TileStore) -> None:
    Storage(store.url).put_json(LOCK_KEY, lease(host="elsewhere", pid=2**22 + 1))
    with pytest.raises(LockedError, match="on elsewhere"), store.lock():
        pass
    with pytest.raises(LockedError, match="on elsewhere"):
        remove_store(store.url)


@pytest.mark.processes
def test_a_held_lease_is_renewed_and_a_lost_lease_is_noticed(
    store_url: str, meta: StoreMeta, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lock, "RENEW_SECONDS", 0.01)
    store, storage = create_store(store_url, meta), Storage(store_url)
    with store.lock() as held:
        first = storage.get_json(LOCK_KEY)["renewed"]
        wait_until(lambda: storage.get_json(LOCK_KEY)["renewed"] > first)
        waits, wait = list[float](), held._stop.wait

        def noted(seconds: float) -> bool:
            waits.append(seconds)
            return wait(seconds)

        monkeypatch.setattr(held._stop, "wait", noted)
        monkeypatch.setattr(lock, "RENEW_SECONDS", 1000.0)
        wait_until(lambda: 1000.0 in waits)  # a renewal is under way
        storage.put_json(LOCK_KEY, lease(host="elsewhere"))
        with pytest.raises(LockedError, match="on elsewhere"):
            held.check()
    assert storage.get_json(LOCK_KEY)["host"] == "elsewhere"


@pytest.mark.processes
def test_the_lock_of_a_killed_run_is_free_at_once(tmp_path: Path, meta: StoreMeta) -> None:
    store = create_store(str(tmp_path / "s"), meta)
    code = (
        "import os, sys; from tiler.store import open_store\n"
        "held = open_store(sys.argv[1]).lock(); held.__enter__(); os._exit(9)"
    )
    died = subprocess.run([sys.executable, "-c", code, store.url], cwd=REPOSITORY, check=False)
    assert died.returncode == 9
    assert Storage(store.url).get(LOCK_KEY) is not None
    with store.lock() as held:
        held.check()


def test_the_store_can_be_removed_by_its_holder(store: TileStore) -> None:
    with store.lock():
        remove_store(store.url)
    assert store.usage().objects == 0


@pytest.mark.parametrize("jump", [-(10**7), 10**7])
def test_a_jump_of_the_clock_does_not_free_a_lease(
    jump: int, store_url: str, meta: StoreMeta, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, now = create_store(store_url, meta), time.time
    with store.lock() as held:
        monkeypatch.setattr(time, "time", lambda: now() + jump)
        with (
            pytest.raises(LockedError, match="in use by process"),
            open_store(store_url).lock(),
        ):
            pass
        held.check()


@pytest.mark.processes
def test_a_lease_of_a_host_with_another_clock_holds_while_it_is_renewed(
    store_url: str, meta: StoreMeta, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, storage, sleep = create_store(store_url, meta), Storage(store_url), time.sleep
    storage.put_json(LOCK_KEY, lease(host="elsewhere", renewed=1000.0))

    def renewed_meanwhile(seconds: float) -> None:
        storage.put_json(LOCK_KEY, lease(host="elsewhere", renewed=1020.0))
        sleep(seconds)

    monkeypatch.setattr(time, "sleep", renewed_meanwhile)
    with pytest.raises(LockedError, match="on elsewhere"), store.lock():
        pass


@pytest.mark.processes
@pytest.mark.parametrize("other", [{"pid_namespace": "pid:[1]"}, {"boot": "another"}])
def test_a_process_number_of_another_container_means_nothing(
    other: dict[str, Any], store: TileStore
) -> None:
    """Two containers may share a host name: a process that is missing here may run in the other one."""
    Storage(store.url).put_json(LOCK_KEY, lease(pid=2**22 + 1, **other))
    remedy = r"wait for it, or stop it; if it was killed, its lease ends 120 s"
    with pytest.raises(LockedError, match=remedy), store.lock():
        pass
    Storage(store.url).put_json(
        LOCK_KEY, lease(pid=2**22 + 1, renewed=time.time() - 1000, **other)
    )
    with store.lock() as held:
        held.check()


def test_a_lease_names_boot_and_processes(store_url: str, meta: StoreMeta) -> None:
    with create_store(store_url, meta).lock():
        body = Storage(store_url).get_json(LOCK_KEY)
    if Path("/proc/self/ns/pid").exists():
        assert body["boot"] == Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        assert body["pid_namespace"].startswith("pid:[")


def test_a_folder_of_results_has_a_lease_of_its_own(tmp_path: Path, meta: StoreMeta) -> None:
    with locked_folder(str(tmp_path)):
        with (
            pytest.raises(LockedError, match=rf"{re.escape(str(tmp_path))}: in use by process"),
            locked_folder(str(tmp_path)),
        ):
            pass
        with create_store(str(tmp_path / "store.zarr"), meta).lock():
            pass
    assert [p.name for p in tmp_path.iterdir()] == ["store.zarr"]


@pytest.mark.processes
def test_a_run_in_another_container_is_alive(tmp_path: Path, meta: StoreMeta) -> None:
    """A PID namespace of its own with the same host name: process 1 in it is not process 1 here."""
    contained = ["unshare", "--pid", "--fork", "--kill-child"]
    if (
        shutil.which("unshare") is None
        or subprocess.run([*contained, "true"], check=False).returncode
    ):
        pytest.skip("no namespaces here")
    store = create_store(str(tmp_path / "s"), meta)
    code = (
        "import sys, time; from tiler.store import open_store\n"
        "with open_store(sys.argv[1]).lock(): print('held', flush=True); sys.stdin.read()"
    )
    holder = subprocess.Popen(
        [*contained, sys.executable, "-c", code, store.url],
        cwd=REPOSITORY,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(LockedError, match="if it was killed, its lease ends"), store.lock():
            pass
        holder.communicate(b"")
    with store.lock():
        pass


def test_a_disk_without_hard_links_has_leases(
    tmp_path: Path, meta: StoreMeta, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Hard links fail, as they do on a memory stick."""

    def refused(*arguments: object) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", refused)
    store = create_store(str(tmp_path / "s"), meta)
    with store.lock() as held:
        held.check()
        with (
            pytest.raises(LockedError, match="in use by process"),
            open_store(store.url).lock(),
        ):
            pass
    with locked_folder(str(tmp_path)):
        pass
    assert sorted(p.name for p in tmp_path.rglob("*") if p.is_file()) == ["zarr.json"]
