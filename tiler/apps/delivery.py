"""Commands `tiler deliver` and `tiler verify`: a folder for a client with a manifest, and its check."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from tiler.apps.evaluate.rasters import open_raster
from tiler.config import RunConfig, without_folders
from tiler.core.crs import split_wkt, vertical_name
from tiler.core.records import new_digest
from tiler.core.review import OK
from tiler.errors import ConfigError, InputError, write_error
from tiler.io.atomic_files import SCRATCH_PREFIX, atomic_path, replace_file
from tiler.io.cloud_reading import BLOCK_BYTES
from tiler.io.foreign_content import excerpt, parse_json_object
from tiler.io.las.headers import read_header
from tiler.io.locations import is_url
from tiler.io.overwrite_check import check_links
from tiler.io.result_folder import (
    CHECK,
    CLASSIFIED,
    OVERVIEW,
    REPORT,
    REVIEW,
    give_results,
    read_run,
    written_rasters,
)
from tiler.observe.events import (
    ExpectedStage,
    JobStarted,
    Listener,
    RunFinished,
    StageFinished,
    StageStarted,
    TaskDone,
    ignore_events,
)
from tiler.report.accuracy import read_measured, seams_text
from tiler.report.client import client_page
from tiler.report.runfile import run_file_errors, write_whole
from tiler.store import locked_folder

MANIFEST = "manifest.json"
PAGE = "index.html"
"""Page for the client."""
UNDER_WAY = f"{SCRATCH_PREFIX}delivery"
"""File in a folder to which a delivery is under way, or was when it was stopped. It is the manifest of the delivery
before it, or empty."""
FORMAT = 1
"""Version of the manifest's form."""
MAX_BYTES = 1 << 28
"""Size from which a file is not read as a manifest."""


@dataclass(frozen=True)
class Delivery:
    """Delivered folder: number and bytes of its files, whether the run left nothing out, and other files.

    Those of an earlier delivery are removed. Those that no delivery wrote, or that somebody changed, are left.
    """

    folder: str
    files: int
    bytes: int
    removed: list[str]
    left: list[str]
    complete: bool


@dataclass(frozen=True)
class Verification:
    """Check of a delivered folder: number of files, and those that are missing, changed, or not in the manifest."""

    files: int
    missing: list[str]
    changed: list[str]
    extra: list[str]


def deliver(out: str | Path, to: str | Path, listener: Listener = ignore_events) -> Delivery:
    """Copy the results of a finished run into a folder, with a manifest.

    The folder gets the files that the run wrote, the report, and ``index.html``, a page for the client. It does not get
    the store, the log and the places to review. A folder of an earlier delivery is brought up to date: files with the
    same bytes keep their times, and files that are not delivered any more are removed unless somebody changed them.
    Other files are left. A folder to which a delivery was stopped has no manifest.

    Parameters
    ----------
    out : path
        Folder of the run.
    to : path
        Folder of the delivery, which is made if it does not exist.
    listener : callable
        Receives events, see `tiler.observe.events`.

    Raises
    ------
    ConfigError
        A folder cannot be used, or the run is not finished.
    InputError
        A file is missing, or was changed since the run wrote it.
    LockedError
        A run uses ``out``.
    ProcessingError
        A file cannot be written, or a raster cannot be read.
    """
    source, target = _folders(out, to)
    run = _finished_run(source)
    with locked_folder(str(source)), run_file_errors(source):
        names = [name for name in run["outputs"] if name != REVIEW]
        names += [REPORT] if (source / REPORT).is_file() else []
        earlier = _earlier_delivery(target)
        check_links("--to", target, [PAGE, *names, *earlier])
        _check_foreign(target, [PAGE, *names], earlier)
        _check_results(source, names, run)
        _begin(target)
        with _shown(listener, "copy", "copy the files", map(source.joinpath, names)) as done:
            entries = [_copied(source, target, name, run, done) for name in sorted(names)]
        check = read_measured(source, CHECK, run)
        entries.append(_page(source, target, {**run, "check": check}, entries))
        manifest = _manifest(run, check, entries)
    delivered = {entry["path"] for entry in entries}
    removed = list(_remove(target, earlier, delivered))
    write_whole(target / MANIFEST, json.dumps(manifest, indent=1).encode())
    (target / UNDER_WAY).unlink(missing_ok=True)
    size, left = sum(entry["bytes"] for entry in entries), _others(target, delivered)
    complete = manifest["verdicts"]["complete"]
    return Delivery(str(to), len(entries), size, removed, left, complete)


def verify(folder: str | Path, listener: Listener = ignore_events) -> Verification:
    """Compare the files of a delivered folder with its manifest.

    Raise InputError if the manifest cannot be read. ``listener`` receives events, see `tiler.observe.events`.
    """
    entries = _entries(Path(folder, MANIFEST))
    missing, changed = [], []
    with _shown(
        listener, "verify", "read the files", map(Path(folder).joinpath, entries)
    ) as done:
        for name, entry in entries.items():
            path = Path(folder, name)
            if not _is_file(path):
                missing.append(name)
            elif (
                path.stat().st_size != entry["bytes"] or _sha256(path, done) != entry["sha256"]
            ):
                changed.append(name)
    return Verification(len(entries), missing, changed, _others(Path(folder), entries))


def _others(folder: Path, names: Iterable[str]) -> list[str]:
    """Return the files in a folder, other than the manifest and ``names``."""
    present = (path for path in folder.rglob("*") if not path.is_dir())
    return sorted(
        {path.relative_to(folder).as_posix() for path in present} - {MANIFEST, *names}
    )


def _folders(out: str | Path, to: str | Path) -> tuple[Path, Path]:
    """Return both folders without links. Raise ConfigError if one contains the other, or is at a URL."""
    for option, folder in (("OUT", out), ("--to", to)):
        if is_url(str(folder)):
            raise ConfigError(f"{option} {folder}: is a URL; give a folder on this machine")
    source, target = Path(out).resolve(), Path(to).resolve()
    if source.is_relative_to(target) or target.is_relative_to(source):
        raise ConfigError(f"--to {to}: contains OUT or lies in it; give another folder")
    return source, target


def _begin(target: Path) -> None:
    """Make the folder, and rename its manifest, which does not describe the folder until the delivery is done."""
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(
            f"--to {target}: cannot be made ({error.strerror}); give a folder"
        ) from error
    try:
        if (target / MANIFEST).is_file():
            replace_file(target / MANIFEST, target / UNDER_WAY)
        elif not (target / UNDER_WAY).exists():
            write_whole(target / UNDER_WAY, b"")
    except OSError as error:
        raise write_error(str(target / UNDER_WAY), error, target) from error


def _finished_run(out: Path) -> dict[str, Any]:
    run = read_run(str(out))
    if run is None:
        raise ConfigError(
            f"{out}: has no results of a run; {give_results(out, 'finished run')}"
        )
    if run["state"] != "done" or not run.get("outputs"):
        raise ConfigError(f"{out}: its run is not finished; run the same command again")
    return run


def _earlier_delivery(target: Path) -> dict[str, Any]:
    """Return the entries of the last manifest in a folder. Raise ConfigError if the folder has other content."""
    manifest, under_way = target / MANIFEST, target / UNDER_WAY
    if manifest.is_file():
        return _entries(manifest)
    if under_way.exists():
        return _entries(under_way) if under_way.stat().st_size else {}
    if target.is_dir() and any(target.iterdir()):
        raise ConfigError(
            f"--to {target}: is not empty and has no {MANIFEST}; give a new folder"
        )
    return {}


def _check_foreign(target: Path, names: Iterable[str], earlier: Mapping[str, Any]) -> None:
    """Raise ConfigError if the folder has a file with the name of a result that is not of a delivery."""
    is_under_way = (target / UNDER_WAY).exists()
    for name in names:
        path = target / name
        if path.exists() and not ((name in earlier or is_under_way) and _is_file(path)):
            raise ConfigError(
                f"--to {target}: its {name} is not of a delivery; move it away, or give another folder"
            )


def _check_results(source: Path, names: Iterable[str], run: Mapping[str, Any]) -> None:
    """Raise InputError if a file of a run is missing, cannot be read, or has another size than the run wrote."""
    for name in names:
        path = source / name
        try:
            with open(path, "rb") as stream:
                size = os.fstat(stream.fileno()).st_size
        except FileNotFoundError as error:
            raise InputError(f"{path}: missing; run again") from error
        except OSError as error:
            raise InputError(
                f"{path}: cannot be read ({error.strerror}); allow reading"
            ) from error
        if size != run["outputs"].get(name, size):
            raise InputError(f"{path}: changed since the run wrote it; run again")


@contextmanager
def _shown(
    listener: Listener, stage: str, title: str, paths: Iterable[Path]
) -> Iterator[Callable[[], None]]:
    """Yield a function to call after each block of bytes. Blocks are the tasks, as files have very different sizes."""
    started = time.monotonic()
    blocks = sum(-(-path.stat().st_size // BLOCK_BYTES) for path in paths if _is_file(path))
    listener(JobStarted([ExpectedStage(stage=stage, title=title, seconds=1.0)]))
    listener(StageStarted(stage, title, tasks=blocks))
    yield lambda: listener(TaskDone(stage, ""))
    seconds = time.monotonic() - started
    listener(StageFinished(stage, seconds))
    listener(RunFinished(seconds))


def _blocks(path: Path, done: Callable[[], None]) -> Iterator[bytes]:
    with open(path, "rb") as stream:
        while block := stream.read(BLOCK_BYTES):
            yield block
            done()


def _copied(
    source: Path, target: Path, name: str, run: Mapping[str, Any], done: Callable[[], None]
) -> dict[str, Any]:
    """Copy a file of a run, and return its entry in the manifest."""
    path, copy = source / name, target / name
    sha256, digest = hashlib.sha256(), new_digest()
    try:
        copy.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(copy) as partial:
            with open(partial, "xb") as writing:
                for block in _blocks(path, done):
                    sha256.update(block)
                    digest.update(block)
                    writing.write(block)
                writing.flush()
                os.fsync(writing.fileno())
            if run["digests"].get(name, digest.hexdigest()) != digest.hexdigest():
                raise InputError(f"{path}: changed since the run wrote it; run again")
            times = path.stat()
            os.utime(partial, ns=(times.st_atime_ns, times.st_mtime_ns))
    except OSError as error:
        raise write_error(str(copy), error, target) from error
    facts = {"path": name, "bytes": copy.stat().st_size, "sha256": sha256.hexdigest()}
    return {**facts, **_facts(copy, name, run)}


def _page(
    source: Path, target: Path, run: Mapping[str, Any], entries: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Write the page for the client, unless it is there, and return its entry in the manifest."""
    content = client_page(source, run, entries)
    path, sha256 = target / PAGE, hashlib.sha256(content).hexdigest()
    if not _is_file(path) or _sha256(path) != sha256:
        write_whole(path, content)
    return {"path": PAGE, "bytes": len(content), "sha256": sha256, "kind": "page"}


def _facts(path: Path, name: str, run: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a client asks of a file: product, pixels, CRS, nodata; number of points of a cloud."""
    if name == OVERVIEW or name.startswith(f"{CLASSIFIED}/"):
        return {"kind": "cloud", "points": read_header(path).point_count}
    if path.suffix != ".tif":
        return {"kind": {".gpkg": "vector", ".html": "page"}.get(path.suffix, "description")}
    rasters = {file: product for product, file in written_rasters(run).items()}
    product = rasters.get(name, name.partition("/")[0])
    with open_raster(path) as raster:
        return {
            "kind": "raster",
            "product": product,
            "columns": raster.width,
            "rows": raster.height,
            "pixel": raster.res[0],
            "bounds": list(raster.bounds),
            "dtype": raster.dtypes[0],
            "nodata": raster.nodata,
            "unit": raster.units[0],
            **_crs_names(raster.crs.to_wkt() if raster.crs else None),
        }


@cache
def _crs_names(wkt: str | None) -> dict[str, str | None]:
    """Return code or name of the horizontal CRS, and name of the height reference, each None if it is not given."""
    horizontal, code = split_wkt(wkt)[0], None
    if horizontal is not None:
        authority = horizontal.to_authority(min_confidence=100)
        code = ":".join(authority) if authority else horizontal.name
    return {"crs": code, "vertical": vertical_name(wkt)}


def _manifest(
    run: Mapping[str, Any], check: Mapping[str, Any], entries: list[dict[str, Any]]
) -> dict[str, Any]:
    """Return the manifest. ``check`` are the measurements of `tiler check`, empty without a check."""
    defaults = RunConfig().to_json()
    given = {
        name: value
        for name, value in without_folders(run["configuration"]).items()
        if value != defaults.get(name)
    }
    current = {} if check.get("older") else check
    return {
        "format": FORMAT,
        "software": f"tiler {run['version']}",
        "libraries": run["libraries"],
        "written": run["written"],
        "units": run["plan"].get("units"),
        "method": run["plan"]["method"],
        "settings": given,
        "inputs": [
            {"name": PurePosixPath(source["path"]).name, "points": source["points"]}
            for source in run["inputs"]
        ],
        "verdicts": {
            "complete": run["exit_code"] == 0,
            "problems": dict(
                Counter(p["what"] for p in run["problems"] if p.get("status") != OK)
            ),
            "review": run.get("review"),
            "seams": seams_text(current["seams"]) if current.get("seams") else "not checked",
            "requirements": current.get("requirements", []),
        },
        "files": entries,
    }


def _remove(target: Path, earlier: Mapping[str, Any], delivered: set[str]) -> Iterator[str]:
    """Remove the files that an earlier delivery wrote and this one does not, if they are unchanged."""
    for name in sorted(earlier.keys() - delivered):
        path = target / name
        if _is_file(path) and _sha256(path) == earlier[name]["sha256"]:
            try:
                path.unlink()
            except OSError as error:
                raise write_error(str(path), error, target) from error
            yield name
            with suppress(OSError):  # A folder that is not empty stays.
                path.parent.rmdir()


def _entries(path: Path) -> dict[str, Any]:
    """Return the entries of a manifest by path. Raise InputError if it is none, or a path leads out of its folder."""
    entries = dict[str, Any]()
    if not _is_file(path):
        if (path.parent / UNDER_WAY).exists():
            raise InputError(
                f"{path.parent}: is incomplete, because its delivery was stopped or is under way; deliver again"
            )
        raise InputError(f"{path}: no such file; give a folder that tiler deliver made")
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError("too large")
        content = parse_json_object(path.read_bytes())
        if content["format"] != FORMAT:
            raise ValueError(f"its format is {excerpt(content['format'])}")
        for entry in content["files"]:
            name, size = entry["path"], entry["bytes"]
            _validate_inside(name)
            if name in entries or type(size) is not int:
                raise ValueError(f"the entry of {excerpt(name)} is wrong or repeated")
            entries[name] = {"bytes": size, "sha256": str(entry["sha256"])}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: cannot be used as a manifest ({error}); get the delivery again, or deliver to another folder"
        ) from error
    return entries


def _validate_inside(name: Any) -> None:
    """Raise ValueError if a path in a manifest is not that of a file in its folder, on any system."""
    inside = PurePosixPath(name)
    is_outside = inside.is_absolute() or ".." in inside.parts or "\\" in name
    if is_outside or PureWindowsPath(name).drive or not inside.name:
        raise ValueError(f"the path {excerpt(name)} leads out of the folder")


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # The name is too long, or has a zero byte.
        return False


def _sha256(path: Path, done: Callable[[], None] = lambda: None) -> str:
    """Return the digest of a file, or raise InputError if it cannot be read."""
    digest = hashlib.sha256()
    try:
        for block in _blocks(path, done):
            digest.update(block)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); copy it again, or allow reading"
        ) from error
    return digest.hexdigest()
