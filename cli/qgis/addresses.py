"""Public addresses that the repository of QGIS plugins requires, read from the installed package.

They are defined only in `pyproject.toml`: in the table ``[project.urls]`` and as ``email`` in
``authors``.
"""

from __future__ import annotations

from email.utils import parseaddr
from importlib.metadata import PackageNotFoundError, metadata

from tiler.errors import ConfigError

DISTRIBUTION = "tiler-dtm"
URLS = {"homepage": "Homepage", "tracker": "Issues", "repository": "Repository"}
"""Key of ``metadata.txt`` -> name in ``[project.urls]``."""
EMAIL = "email"


def addresses() -> dict[str, str]:
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


def validate_addresses(found: dict[str, str]) -> None:
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
