"""What a name stands for, once and for all: a branch of the Hub is held at the commit that it named first."""

from __future__ import annotations

import re
from pathlib import Path

__all__ = ["Pins", "repository_id"]

_REPOSITORY = re.compile(r"(?:hf://datasets/)?(?P<repo>[\w.-]+/[\w.-]+)")


class Pins:
    """The commits of repositories of the Hub, each looked up on first use and kept.

    Parameters
    ----------
    revision : str or None
        Branch, tag or commit that is meant.
    """

    def __init__(self, revision: str | None) -> None:
        self._revision = revision
        self._commits: dict[str, str] = {}

    def commit_of(self, place: str) -> str | None:
        """Return the commit of a repository; None for a folder or a file.

        Raises
        ------
        HubError
            The repository or its revision does not exist, or cannot be reached and is not cached.
        """
        repo_id = repository_id(place)
        if repo_id is None:
            return None
        commit = self._commits.get(repo_id)
        if commit is None:
            from tactile_toolkit.hub.repository import HubRepository

            # The first answer stays, whichever thread it came from.
            commit = self._commits.setdefault(repo_id, HubRepository(repo_id, self._revision).snapshot.commit)
        return commit


def repository_id(place: str) -> str | None:
    """Return the repository (``USER/NAME``) that a place names; None for what is, or can only be, a path."""
    if place.startswith((".", "/", "~")) or Path(place).expanduser().exists():
        return None
    match = _REPOSITORY.fullmatch(place)
    return None if match is None else match["repo"]
