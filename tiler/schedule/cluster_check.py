"""Checks of the workers of a cluster before the first task: versions, and access to inputs, store and OUT."""

from __future__ import annotations

import platform
import uuid
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tiler.errors import ConfigError, ConnectionLostError, TilerError, write_error
from tiler.io.locations import FileState, as_path, is_url, joined, state_of, try_write
from tiler.schedule import Machine
from tiler.store import open_store
from tiler.version import __version__

LIBRARIES = (
    "numpy",
    "scipy",
    "numba",
    "zarr",
    "laspy",
    "lazrs",
    "rasterio",
    "pyproj",
    "shapely",
    "pyogrio",
    "contourpy",
    "distributed",
)
"""Libraries whose versions must be equal, since they change the bytes of results or the
messages to workers."""

LOOKED_AT = 20
"""Approximate number of inputs that each worker checks: the first, the last, and some between
them."""


def versions() -> dict[str, str]:
    """Return the versions of tiler, Python and `LIBRARIES` in this process."""
    python = ".".join(platform.python_version_tuple()[:2])
    return {
        "tiler": __version__,
        "Python": python,
        **{name: version(name) for name in LIBRARIES},
    }


class ClusterAccess:
    """Check of the workers of a cluster. An instance is a `tiler.schedule.WorkerCheck`.

    Parameters
    ----------
    scheduler : str
        Address of the scheduler, for messages.
    sources : sequence of (str, FileState)
        Path or URL of each input, and its state in the plan.
    store_url : str or None
        URL of the store, or None if it is not known yet.
    products : str or None
        Folder or URL of the files that the run writes, or None if it is not known yet.
    store_there : bool
        Whether there is a store. If not, its future location is checked.

    Attributes
    ----------
    out_seen : bool
        Whether all workers checked so far can write to OUT.
    """

    def __init__(
        self,
        scheduler: str,
        sources: Sequence[tuple[str, FileState]],
        store_url: str | None,
        products: str | None,
        store_there: bool = True,
    ) -> None:
        self._scheduler = scheduler
        self._store_url = store_url
        self._store_there = store_there
        step = max(len(sources) // LOOKED_AT, 1)
        self._sources = [*sources[::step], *sources[-1:]]
        self._products = products
        self.out_seen = True

    def __call__(self, ask: Callable[..., Any], worker: str) -> None:
        """Raise ConfigError if a worker cannot take part."""
        found = self._asked(ask, worker, versions)
        here = versions()
        others = [f"{n} {found.get(n)}, here {v}" for n, v in here.items() if found.get(n) != v]
        if others:
            self._refuse(worker, f"has {'; '.join(others)}; install the same versions")
        for place, reason in self._asked(ask, worker, unreadable, self._sources):
            self._refuse(worker, f"cannot read {place} ({reason}); {_remedy(place, 'inputs')}")
        if self._store_url is not None:
            for reason in self._store_trouble(ask, worker, self._store_url):
                self._refuse(
                    worker,
                    f"cannot use {self._store_url} ({reason}); {_remedy(self._store_url, '--store')}",
                )
        if self._products is not None and is_url(self._products):
            for reason in self._asked(ask, worker, unwritable, self._products):
                self._refuse(
                    worker,
                    f"cannot write to {self._products} ({reason}); {_remedy(self._products, '-o')}",
                )
        elif self._products is not None:
            self.out_seen &= self._seen(ask, worker, self._products)

    def validate_memory(self, machines: Iterable[Machine], need_bytes: int) -> None:
        """Raise ConfigError for a machine with too little memory for a task per thread, ``need_bytes`` each."""
        for machine in machines:
            if machine.threads * need_bytes > machine.memory_bytes:
                raise ConfigError(
                    f"--scheduler {self._scheduler}: machine {machine.name} has {machine.memory_bytes >> 20:,} MiB "
                    f"for {machine.threads} tasks at a time of up to {need_bytes >> 20:,} MiB; "
                    "start fewer workers there, or use less --memory"
                )

    def _store_trouble(self, ask: Callable[..., Any], worker: str, url: str) -> list[str]:
        """Return the reasons why a worker cannot use the store or its future location, or an empty list if it can."""
        if self._store_there:
            return list(self._asked(ask, worker, unusable, url))
        if is_url(url):
            return list(self._asked(ask, worker, unwritable, url))
        if self._seen(ask, worker, url):
            return []
        return ["it cannot access that folder, or cannot write there"]

    def _seen(self, ask: Callable[..., Any], worker: str, folder: str) -> bool:
        """Return whether a worker can write to a folder of the client, or to its nearest existing parent."""
        place = Path(folder).absolute()
        token = (
            next(p for p in (place, *place.parents) if p.is_dir())
            / f".tiler-{uuid.uuid4().hex}.partial"
        )
        try:
            token.touch()
            return bool(self._asked(ask, worker, sees, str(token)))
        except OSError as error:
            raise write_error(str(token.parent), error) from error
        finally:
            token.unlink(missing_ok=True)

    def _asked(
        self,
        ask: Callable[..., Any],
        worker: str,
        function: Callable[..., Any],
        *arguments: Any,
    ) -> Any:
        try:
            return ask(function, *arguments)
        except ConnectionLostError:
            raise
        except Exception as error:
            text = f"cannot run functions of tiler {__version__} ({type(error).__name__}: {error}); install it there, "
            raise self._refusal(
                worker, text + "with the same versions of libraries as here"
            ) from error

    def _refuse(self, worker: str, what: str) -> None:
        raise self._refusal(worker, what)

    def _refusal(self, worker: str, what: str) -> ConfigError:
        return ConfigError(f"--scheduler {self._scheduler}: worker {worker} {what}")


def _remedy(place: str, what: str) -> str:
    if is_url(place):
        return "check the URL and the credentials of the workers"
    return f"give {what} by URL (s3://...), or on a disk that all machines share"


def unreadable(sources: Sequence[tuple[str, FileState]]) -> list[tuple[str, str]]:
    """Return the first input that this worker cannot read, and the reason, or an empty list if it can read all."""
    for place, state in sources:
        try:
            found = state_of(as_path(place))
        except (OSError, TilerError) as error:
            return [(place, getattr(error, "strerror", None) or str(error))]
        if found.size != state.size:
            return [(place, f"{found.size:,} bytes there, {state.size:,} here")]
        if found != state:
            return [
                (
                    place,
                    "the same size, but another modification time; copy it with cp -p or rsync -t, which keep the time",
                )
            ]
    return []


def unusable(store_url: str) -> list[str]:
    """Return the reason why this worker cannot read or write the store, or an empty list if it can."""
    try:
        open_store(store_url).try_write(uuid.uuid4().hex)
    except Exception as error:  # noqa: BLE001 - Libraries of object stores have their own exceptions.
        return [str(error)]
    return []


def unwritable(url: str) -> list[str]:
    """Return the reason why this worker cannot write at a URL, or an empty list if it can."""
    try:
        try_write(joined(url, f".tiler-{uuid.uuid4().hex}"))
    except OSError as error:
        return [str(error)]
    return []


def sees(token: str) -> bool:
    """Return whether this worker can access a file of the client and write to its folder."""
    mine = Path(f"{token}.worker.partial")
    try:
        if not Path(token).exists():
            return False
        mine.touch()
        mine.unlink()
    except OSError:
        return False
    return True
