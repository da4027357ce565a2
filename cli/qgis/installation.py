"""Puts the plugin into a profile of QGIS, or into an archive."""

from __future__ import annotations

import json
import os
import shutil
import sys
import sysconfig
import zipfile
from importlib.resources import files
from pathlib import Path
from typing import Any

from cli.qgis.addresses import addresses, refuse_without
from cli.qgis.table import table
from tiler.errors import ConfigError, refused_write
from tiler.io.partial_files import appearing
from tiler.version import __version__

FOLDER = "tiler_qgis"
"""Name of the plugin's folder, and by that of its Python package."""
TABLE = "settings.json"
MARK = "tiler-dtm"
"""Says in `TABLE` whose folder it is."""
FIRST_TIME = (1980, 1, 1, 0, 0, 0)
"""Time of each file in an archive: equal plugins are equal bytes."""


def plugin_files(command: str = "") -> dict[str, bytes]:
    """Name -> content of the plugin's files.

    Parameters
    ----------
    command : str
        Path of ``tiler``; empty: the plugin looks for it in ``PATH``.
    """
    found = {
        item.name: item.read_bytes()
        for item in files("cli.qgis").joinpath("plugin").iterdir()
        if item.name.endswith((".py", ".txt", ".png")) or item.name == "LICENSE"
    }
    found["metadata.txt"] = _metadata(found["metadata.txt"].decode()).encode()
    content: dict[str, Any] = {
        "made_by": MARK,
        "command": command,
        "files": sorted([*found, TABLE]),
        **table(),
    }
    found[TABLE] = (json.dumps(content, indent=1) + "\n").encode()
    return dict(sorted(found.items()))


def install(profile: str) -> Path:
    """Write the plugin into a profile of QGIS, in place of an earlier version of it; its folder.

    Raises
    ------
    ConfigError
        There is no such profile, or something else has the place.
    """
    target = _profile_folder(profile) / "python" / "plugins" / FOLDER
    earlier = _own_files(target)
    new = plugin_files(find_own_command())
    try:
        target.mkdir(parents=True, exist_ok=True)
        # The table first: a folder that was left half written is known by it.
        for name in sorted(new, key=lambda name: name != TABLE):
            with appearing(target / name) as part:
                part.write_bytes(new[name])
        for name in earlier - new.keys():
            (target / name).unlink(missing_ok=True)
    except OSError as error:
        raise refused_write(str(target), error, target.parent) from error
    return target


def package(target: Path, upload: bool = False) -> None:
    """Write the plugin into an archive, from which QGIS installs it on any machine.

    Raises
    ------
    ConfigError
        Something else has the name, or the archive is for ``upload`` to the repository of QGIS plugins, and lacks an
        address.
    """
    if upload:
        refuse_without(addresses())
    if target.exists() and not _is_package(target):
        raise ConfigError(f"{target}: is there and no package of this plugin; choose another name")
    try:
        with appearing(target) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in plugin_files().items():
                entry = zipfile.ZipInfo(f"{FOLDER}/{name}", FIRST_TIME)
                entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
                archive.writestr(entry, content)
    except OSError as error:
        raise refused_write(str(target), error, target.parent) from error


def _metadata(text: str) -> str:
    """The plugin's metadata with this version, and with the addresses that the project has."""
    values = {"version": __version__, **addresses()}
    lines = []
    for line in text.splitlines():
        key = line.partition("=")[0]
        lines.append(f"{key}={values[key]}" if key in values else line)
    return "\n".join(lines) + "\n"


def find_own_command() -> str:
    """The path of the command that runs. Raises ConfigError."""
    called = Path(sys.argv[0])
    own = [str(called.absolute())] if called.stem == "tiler" else []
    for place in (*own, os.path.join(sysconfig.get_path("scripts"), "tiler"), "tiler"):
        if found := shutil.which(place):
            return os.path.abspath(found)
    raise ConfigError(
        f"no command tiler beside {sys.executable}; install the package (pip install tiler-dtm)"
    )


def profiles_folder() -> Path:
    """Where this user's QGIS keeps its profiles."""
    own = os.environ.get("QGIS_CUSTOM_CONFIG_PATH")
    if own:
        return Path(own) / "profiles"
    if os.environ.get("APPDATA") and sys.platform == "win32":
        data = Path(os.environ["APPDATA"])
    elif sys.platform == "darwin":
        data = Path.home() / "Library" / "Application Support"
    else:
        data = Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share")
    return data / "QGIS" / "QGIS3" / "profiles"


def _profile_folder(name: str) -> Path:
    folder = profiles_folder()
    there = sorted(p.name for p in folder.iterdir() if p.is_dir()) if folder.is_dir() else []
    if name not in there and name != "default":
        raise ConfigError(
            f"{folder}: no profile {name!r} of QGIS, there are: {', '.join(there) or 'none'}; make it in QGIS "
            "(Settings > User Profiles) or give another with --profile"
        )
    return folder / name


def _own_files(folder: Path) -> set[str]:
    """Files of an earlier version in this folder. Raises ConfigError where the folder is not ours."""
    if not os.path.lexists(folder):
        return set()
    try:
        if folder.is_symlink():
            raise ValueError
        content = json.loads((folder / TABLE).read_text("utf-8"))
        if content["made_by"] != MARK:
            raise ValueError
        return {str(name) for name in content["files"] if Path(name).name == name}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"{folder}: is there, and `tiler qgis install` did not write it; remove or rename it first"
        ) from error


def _is_package(path: Path) -> bool:
    try:
        with zipfile.ZipFile(path) as archive:
            return bool(json.loads(archive.read(f"{FOLDER}/{TABLE}"))["made_by"] == MARK)
    except (OSError, zipfile.BadZipFile, ValueError, KeyError, TypeError):
        return False
