"""Lists of clouds: virtual point clouds (``.vpc``, JSON by QGIS or pdal_wrench), and reading of any list in a child.

The child process has limits, as for untrusted data. Lists are ``.vpc`` files and Entwine Point Tiles.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn, TypeVar
from urllib.parse import unquote, urljoin, urlsplit

from tiler.errors import InputError
from tiler.io.cloud_reading import open_location
from tiler.io.foreign_content import excerpt, member, parse_json_object
from tiler.io.locations import as_path, is_url, reading_remedy
from tiler.schedule import call_isolated
from tiler.schedule.guard import MEMORY_BYTES

Read = TypeVar("Read")

LIST_BYTES = 1 << 28
"""Maximum size of a list in bytes. pdal_wrench writes some kilobytes per cloud."""
MAX_CLOUDS = 1 << 18
"""Maximum number of clouds in a list. A URL takes 1.4 kB of memory before any cloud is read."""
LIST_SECONDS = 300.0
"""Maximum time in seconds for reading a whole ``.vpc`` or hierarchy, however slow its server
is."""


def read_list(
    text: str, function: Callable[..., Read], *arguments: Any, in_process: bool = False
) -> Read:
    """Call ``function(*arguments)`` in a child process and return its result.

    Parameters
    ----------
    text : str
        Path or URL of the list.
    function : callable
        Function of a module, since function, arguments and result are pickled.
    in_process : bool
        Call the function in this process, without limits.

    Raises
    ------
    InputError
        The list cannot be read within `LIST_SECONDS` and `MEMORY_BYTES`.
    """
    if in_process:
        return function(*arguments)
    return call_isolated(
        function,
        *arguments,
        paths=(as_path(text),),
        memory_bytes=MEMORY_BYTES,
        seconds=LIST_SECONDS,
        remedy="get it again, or give the clouds themselves",
        smaller="give the clouds themselves",
    )


SUFFIX = ".vpc"
REMOTE = ("http", "https", "s3", "gs", "gcs", "abfs", "abfss", "az")
"""Schemes of the URLs that such a file may contain."""


def is_virtual(text: str | Path) -> bool:
    """Return whether an input has the name of a virtual point cloud."""
    path = str(text).partition("?")[0] if is_url(text) else str(text)
    return path.lower().endswith(SUFFIX)


def members(text: str, suffixes: tuple[str, ...]) -> list[str]:
    """Return the paths and URLs of the clouds in a virtual point cloud, in its order, each once.

    Parameters
    ----------
    text : str
        Path or URL of the virtual point cloud. Relative names in it are relative to its folder.
    suffixes : tuple of str
        Suffixes of the clouds that can be read.

    Raises
    ------
    InputError
        The file cannot be read, is not a virtual point cloud, or lists something that cannot be an input.
    """
    locations: dict[str, None] = {}
    for number, feature in enumerate(_features(text), start=1):
        href = _href(member(feature, "assets"))
        if not isinstance(href, str) or not href or "\0" in href:
            _refuse(text, f"its feature {number} names no cloud")
        if not href.partition("?")[0].lower().endswith(suffixes):
            _refuse(
                text,
                f"its feature {number} names {excerpt(href)}, no file of {', '.join(suffixes)}",
            )
        location = _resolved(text, href)
        if not _is_name(location):
            _refuse(
                text,
                f"its feature {number} names {excerpt(href)}, which holds half of a character",
            )
        locations.setdefault(location)
    if not locations:
        _refuse(text, "names no cloud at all")
    if len(locations) > MAX_CLOUDS:
        _refuse(text, f"names {len(locations)} clouds, {MAX_CLOUDS} at most can be read")
    return list(locations)


def _href(assets: Mapping[str, Any]) -> Any:
    """Return the location of a feature's cloud, from the asset ``data`` or else the first with one."""
    href = member(assets, "data").get("href")
    if href:
        return href
    for asset in assets.values():
        if isinstance(asset, dict) and "href" in asset:
            return asset["href"]
    return None


def _is_name(place: str) -> bool:
    """Return whether a text can name a file. JSON may contain lone surrogates, which cannot."""
    try:
        return bool(place.encode() if is_url(place) else os.fsencode(place))
    except UnicodeEncodeError:
        return False


def _features(text: str) -> list[Any]:
    try:
        with open_location(as_path(text)) as stream:
            content = stream.read(LIST_BYTES + 1)
    except OSError as error:
        raise InputError(
            f"{text}: cannot be read ({error.strerror or error}); {reading_remedy(text, 'give a readable .vpc file')}"
        ) from error
    if len(content) > LIST_BYTES:
        _refuse(text, f"has more than {LIST_BYTES >> 20} MiB")
    try:
        document = parse_json_object(content)
    except ValueError as error:  # This includes errors of UTF-8.
        _refuse(text, " ".join(str(error).split()))
    features = document.get("features")
    if document.get("type") != "FeatureCollection" or not isinstance(features, list):
        _refuse(text, "holds no FeatureCollection")
    return features


def _resolved(text: str, href: str) -> str:
    """Return the path or URL of a cloud in a virtual point cloud.

    A virtual point cloud at a URL must not make this machine read its own files or open chained
    file systems.
    """
    scheme = urlsplit(href).scheme.lower() if is_url(href) else ""
    if scheme:
        if scheme not in REMOTE or "::" in href:
            _refuse(text, f"names {excerpt(href)}, which no virtual point cloud may")
        return href
    if not is_url(text):
        return str(Path(text).parent / href)
    base, _, chained = text.partition("?")[0].partition("::")
    if Path(href).is_absolute() or chained or ".." in Path(unquote(href)).parts:
        _refuse(text, f"names {excerpt(href)}, which is outside the folder of this file")
    # `urljoin` joins only paths of known schemes, such as http.
    system, _, host_and_path = base.partition("://")
    return f"{system}://{urljoin('http://' + host_and_path, href).removeprefix('http://')}"


def _refuse(text: str, what: str) -> NoReturn:
    raise InputError(
        f"{text}: the file is not a readable virtual point cloud: {what}; write it again"
    )
