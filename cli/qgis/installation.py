"""Installation of the plugin in a profile of QGIS, and its packaging as an archive.

The repository of QGIS plugins requires public addresses. They are defined only in `pyproject.toml`: in the table
``[project.urls]`` and as ``email`` in ``authors``. Here they are read from the installed package.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import sysconfig
import zipfile
from email.utils import parseaddr
from importlib.metadata import PackageNotFoundError, metadata
from importlib.resources import files
from pathlib import Path
from typing import Any

from cli.qgis.table import table
from tiler.errors import ConfigError, write_error
from tiler.io.atomic_files import atomic_path
from tiler.version import __version__

FOLDER = "tiler_qgis"
"""Name of the plugin's folder, which is also the name of its Python package."""
TABLE = "settings.json"
MARK = "tiler-dtm"
"""Entry of `TABLE` that shows that tiler wrote the folder."""
FIRST_TIME = (1980, 1, 1, 0, 0, 0)
"""Time of each file in an archive. It is fixed, so that equal plugins have equal bytes."""


def plugin_files(command: str = "") -> dict[str, bytes]:
    """Return the content of the plugin's files by name.

    Parameters
    ----------
    command : str
        Path of ``tiler``. If it is empty, the plugin looks for it in ``PATH``.
    """
    content_by_name = {
        item.name: item.read_bytes()
        for item in files("cli.qgis").joinpath("plugin").iterdir()
        if item.name.endswith((".py", ".txt", ".png")) or item.name == "LICENSE"
    }
    content_by_name["metadata.txt"] = _metadata(
        content_by_name["metadata.txt"].decode()
    ).encode()
    content: dict[str, Any] = {
        "made_by": MARK,
        "command": command,
        "files": sorted([*content_by_name, TABLE]),
        **table(),
    }
    content_by_name[TABLE] = (json.dumps(content, indent=1) + "\n").encode()
    return dict(sorted(content_by_name.items()))


def install(profile: str) -> Path:
    """Write the plugin into a profile of QGIS, replace an earlier version, and return the plugin's folder.

    Raises
    ------
    ConfigError
        The profile does not exist, or another folder or file has the name of the plugin.
    """
    target = _profile_folder(profile) / "python" / "plugins" / FOLDER
    earlier = _own_files(target)
    new = plugin_files(find_own_command())
    try:
        target.mkdir(parents=True, exist_ok=True)
        # The table is first, because it identifies a folder that was only partly written.
        for name in sorted(new, key=lambda name: name != TABLE):
            with atomic_path(target / name) as part:
                part.write_bytes(new[name])
        for name in earlier - new.keys():
            (target / name).unlink(missing_ok=True)
    except OSError as error:
        raise write_error(str(target), error, target.parent) from error
    return target


def package(target: Path, upload: bool = False) -> None:
    """Write the plugin into an archive, from which QGIS installs it on any machine.

    Raises
    ------
    ConfigError
        Another file has the name, or the archive is for ``upload`` to the repository of QGIS plugins and an address is
        missing.
    """
    if upload:
        _validate_addresses(_addresses())
    if target.exists() and not _is_package(target):
        raise ConfigError(
            f"{target}: already exists and is not a package of this plugin; give another name"
        )
    try:
        with (
            atomic_path(target) as part,
            zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive,
        ):
            for name, content in plugin_files().items():
                entry = zipfile.ZipInfo(f"{FOLDER}/{name}", FIRST_TIME)
                entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
                archive.writestr(entry, content)
    except OSError as error:
        raise write_error(str(target), error, target.parent) from error


def _metadata(text: str) -> str:
    """Return the plugin's metadata with this version and the addresses of the project."""
    values = {"version": __version__, **_addresses()}
    lines = []
    for line in text.splitlines():
        key = line.partition("=")[0]
        lines.append(f"{key}={values[key]}" if key in values else line)
    return "\n".join(lines) + "\n"


def find_own_command() -> str:
    """Return the path of the running command, or raise ConfigError."""
    called = Path(sys.argv[0])
    # On Windows, scripts get their path without the suffix, and Python 3.11 does not add it.
    name = "tiler.exe" if os.name == "nt" else "tiler"
    called_paths = [str(called.absolute().with_name(name))] if called.stem == "tiler" else []
    for command in (*called_paths, os.path.join(sysconfig.get_path("scripts"), name), name):
        if path := shutil.which(command):
            return os.path.abspath(path)
    raise ConfigError(
        f"{sys.executable}: has no command tiler next to it; install the package (pip install tiler-dtm)"
    )


def profiles_folder() -> Path:
    """Return the folder in which QGIS stores the profiles of this user."""
    custom_folder = os.environ.get("QGIS_CUSTOM_CONFIG_PATH")
    if custom_folder:
        return Path(custom_folder) / "profiles"
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
            f"{folder}: has no QGIS profile {name!r}, only: {', '.join(there) or 'none'}; create it in QGIS "
            "(Settings > User Profiles) or give another one with --profile"
        )
    return folder / name


def _own_files(folder: Path) -> set[str]:
    """Return the files of an earlier version in this folder, or raise ConfigError if tiler did not write it."""
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
            f"{folder}: already exists and was not written by `tiler qgis install`; remove or rename it first"
        ) from error


def _is_package(path: Path) -> bool:
    try:
        with zipfile.ZipFile(path) as archive:
            return bool(json.loads(archive.read(f"{FOLDER}/{TABLE}"))["made_by"] == MARK)
    except (OSError, zipfile.BadZipFile, ValueError, KeyError, TypeError):
        return False


DISTRIBUTION = "tiler-dtm"
URLS = {"homepage": "Homepage", "tracker": "Issues", "repository": "Repository"}
"""Key of ``metadata.txt`` -> name in ``[project.urls]``."""
EMAIL = "email"


def _addresses() -> dict[str, str]:
    """Return the addresses of the project by their keys in ``metadata.txt``."""
    try:
        package_metadata = metadata(DISTRIBUTION)
    except PackageNotFoundError:  # a checkout that is not installed
        return {}
    urls = dict(entry.split(", ", 1) for entry in package_metadata.get_all("Project-URL") or ())
    address_by_key = {key: urls.get(name, "") for key, name in URLS.items()}
    _, address_by_key[EMAIL] = parseaddr(
        "".join(package_metadata.get_all("Author-email") or ())
    )
    return {key: address for key, address in address_by_key.items() if address}


def _validate_addresses(found: dict[str, str]) -> None:
    """Raise ConfigError if an address is missing that the repository of QGIS plugins requires."""
    missing = [f"{name} in [project.urls]" for key, name in URLS.items() if key not in found]
    if EMAIL not in found:
        missing.append("email in authors")
    if missing:
        raise ConfigError(
            f"pyproject.toml: has no {', no '.join(missing)}, which the repository of QGIS plugins requires; "
            "add the missing values and install tiler again, or leave out --upload"
        )
    for key, address in found.items():
        if key != EMAIL and not address.startswith("https://"):
            raise ConfigError(
                f"pyproject.toml: {URLS[key]} in [project.urls] does not begin with https:// ({address}); "
                "give an https address"
            )
