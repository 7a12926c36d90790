"""How data sets of the Hub are named: ``USER/NAME``, with a revision, or by the address of a file in them."""

from __future__ import annotations

import re
from dataclasses import dataclass

from tactile_toolkit.errors import InputError

__all__ = ["HubName", "hub_name"]

_PREFIX = "hf://datasets/"
# Names of branches that hold a slash are written %2F, but for the two kinds that the Hub makes itself.
_NAME = re.compile(
    r"(?P<repo>[\w.-]+/[\w.-]+)"
    r"(?:@(?P<revision>refs/convert/[\w.-]+|refs/pr/\d+|[^/@]+))?"
    r"(?:/(?P<path>[^/].*?))?/?"
)


@dataclass(frozen=True, slots=True)
class HubName:
    """What a name of the Hub means.

    Attributes
    ----------
    repo_id : str
        ``USER/NAME``.
    revision : str or None
        Branch, tag or commit that is named with it.
    path : str
        File or folder of the repository; empty for all of it.
    """

    repo_id: str
    revision: str | None
    path: str


def hub_name(name: str, revision: str | None = None) -> HubName | None:
    """Read ``USER/NAME[@REVISION]`` or ``hf://datasets/USER/NAME[@REVISION][/PATH]``; None for other names.

    Parameters
    ----------
    name : str
        What the user gave.
    revision : str, optional
        Branch, tag or commit that was given beside it.

    Raises
    ------
    InputError
        Two revisions are given.
    """
    match = _NAME.fullmatch(name.removeprefix(_PREFIX))
    is_address = name.startswith(_PREFIX)
    if match is None or name.startswith((".", "~")) or (match["path"] and not is_address):
        return None
    named = match["revision"].replace("%2F", "/") if match["revision"] else None
    if named and revision and named != revision:
        message = (
            f"{name!r} names the revision {named!r}, and {revision!r} is given beside it; "
            "next: leave one of them away"
        )
        raise InputError(message)
    return HubName(match["repo"], named or revision, match["path"] or "")
