"""Virtual point clouds: JSON files (``.vpc``) that name clouds, as QGIS and pdal_wrench write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote, urljoin, urlsplit

from tiler.errors import InputError
from tiler.io.cloud_reading import open_cloud
from tiler.io.json_text import excerpt, member, read_object
from tiler.io.locations import cloud_path, is_url

SUFFIX = ".vpc"
MOST_BYTES = 1 << 28
"""Of such a file: one of pdal_wrench has some kilobytes for each of its clouds."""
REMOTE = ("http", "https", "s3", "gs", "gcs", "abfs", "abfss", "az")
"""Schemes that such a file may name clouds by."""


def is_virtual(text: str | Path) -> bool:
    """Whether an input is named as a virtual point cloud is."""
    place = str(text).partition("?")[0] if is_url(text) else str(text)
    return place.lower().endswith(SUFFIX)


def members(text: str, suffixes: tuple[str, ...]) -> list[Path]:
    """The clouds that a virtual point cloud names, in its order, each once.

    Parameters
    ----------
    text : str
        Its path or URL. Relative names in it are looked for from there.
    suffixes : tuple of str
        Of the clouds that can be read.

    Raises
    ------
    InputError
        It cannot be read, is no virtual point cloud, or names what no input can be.
    """
    found: dict[str, Path] = {}
    for number, feature in enumerate(_features(text)):
        assets = member(feature, "assets")
        href = member(assets, "data").get("href") or next(
            (asset["href"] for asset in assets.values() if isinstance(asset, dict) and "href" in asset), None
        )
        if not isinstance(href, str) or not href or "\0" in href:
            _refuse(text, f"its feature {number + 1} names no cloud")
        if not href.partition("?")[0].lower().endswith(suffixes):
            _refuse(text, f"its feature {number + 1} names {excerpt(href)}, no file of {', '.join(suffixes)}")
        place = _resolved(text, href)
        found.setdefault(place, cloud_path(place))
    if not found:
        _refuse(text, "names no cloud at all")
    return list(found.values())


def _features(text: str) -> list[Any]:
    """The features of the collection that a virtual point cloud is."""
    try:
        with open_cloud(cloud_path(text)) as stream:
            content = stream.read(MOST_BYTES + 1)
    except OSError as error:
        raise InputError(
            f"{text}: cannot be read ({error.strerror or error}); name a readable .vpc file"
        ) from error
    if len(content) > MOST_BYTES:
        _refuse(text, f"has more than {MOST_BYTES >> 20} MiB")
    try:
        found = read_object(content)
    except ValueError as error:  # of bytes that are no UTF-8 as well
        _refuse(text, " ".join(str(error).split()))
    features = found.get("features")
    if found.get("type") != "FeatureCollection" or not isinstance(features, list):
        _refuse(text, "holds no FeatureCollection")
    return features


def _resolved(text: str, href: str) -> str:
    """The path or URL of a cloud that a virtual one names.

    One that came from elsewhere must not make this machine read its own files for it, nor open chains of file systems.
    """
    scheme = urlsplit(href).scheme.lower() if is_url(href) else ""
    if scheme and (scheme not in REMOTE or "::" in href):
        _refuse(text, f"names {excerpt(href)}, which no virtual point cloud may")
    if scheme:
        return href
    if not is_url(text):
        return str(Path(text).parent / href)
    base, _, chained = text.partition("?")[0].partition("::")
    if Path(href).is_absolute() or chained or ".." in Path(unquote(href)).parts:
        _refuse(text, f"names {excerpt(href)}, which is not below the folder that it lies in")
    # urljoin knows how to join paths of http alone.
    system, _, place = base.partition("://")
    return f"{system}://{urljoin('http://' + place, href).removeprefix('http://')}"


def _refuse(text: str, what: str) -> NoReturn:
    raise InputError(f"{text}: is no virtual point cloud that can be read: {what}; write it again")
