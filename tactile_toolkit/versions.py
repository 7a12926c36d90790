"""Versions of the toolkit and of the libraries that decide what it writes."""

from __future__ import annotations

from functools import cache
from importlib.metadata import PackageNotFoundError, version

DISTRIBUTION = "tactile-toolkit"


@cache
def toolkit_version() -> str:
    """Return the installed version of the toolkit, or ``"unknown"`` in a bare checkout."""
    try:
        return version(DISTRIBUTION)
    except PackageNotFoundError:
        return "unknown"


def library_versions(*distributions: str) -> dict[str, str]:
    """Return the installed versions of other distributions."""
    return {name: version(name) for name in distributions}
