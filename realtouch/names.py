"""Short names of the published data sets."""

from __future__ import annotations

from os import PathLike

from realtouch.kind import KIND
from tactile_toolkit.catalog.published import place_of

__all__ = ["Name", "Place", "SHORT_NAMES", "repository_of"]

SHORT_NAMES = {
    name: entry.repo_id.partition("/")[2] for entry in KIND.published for name in (entry.name, *entry.aliases)
}
"""Short name to the name of the published repository, without its owner."""


def repository_of(name: str) -> str:
    """Return the Hub repository of a short name, unless there is a data set of that name in this folder.

    Any other name is returned as it is.
    """
    return place_of(name)


Name = str | PathLike[str]


Place = str | tuple[str, ...]
