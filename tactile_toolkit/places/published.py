"""The published data sets: their short names, and their state on the Hub and in its cache."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress

from tactile_toolkit import hub, run
from tactile_toolkit.errors import InputError, ToolkitError
from tactile_toolkit.kind import DatasetKind, PublishedSet, kinds
from tactile_toolkit.wording import did_you_mean, shortened

_LONGEST_SHOWN = 200
_THREADS = 8


def published_set(name: str) -> PublishedSet | None:
    """Return a published set by its short name or its repository; None for any other name."""
    entries = (entry for kind in kinds() for entry in kind.published)
    return next((each for each in entries if name in (each.name, each.repo_id, *each.aliases)), None)


def kind_of_published(name: str) -> DatasetKind | None:
    """Return the kind of a published set by its short name or its repository; None for any other name."""
    known = published_set(name)
    return next((kind for kind in kinds() if known in kind.published), None)


def repository_named(name: str, revision: str | None = None) -> hub.HubName:
    """Resolve a name of the Hub, or the short name of a published set, to a repository.

    Raises InputError for other names, and for a part of a repository.
    """
    named = named_on_hub(name, revision)
    if named.path:
        raise InputError(
            f"{name!r} is a part of a repository; expected all of it", next=f"leave {named.path!r} out"
        )
    return named


def named_on_hub(name: str, revision: str | None) -> hub.HubName:
    """Resolve a name or short name to a repository, or a path in one; InputError for other names."""
    known = published_set(name)
    repo_id = name
    if known is not None:
        repo_id = known.repo_id
    named = hub.hub_name(repo_id, revision)
    if named is None:
        published = {entry.name: kind.command for kind in kinds() for entry in kind.published}
        lists = ", ".join(f"`{command} list`" for command in dict.fromkeys(published.values()))
        raise InputError(
            f"{shortened(name, _LONGEST_SHOWN)!r} does not exist; expected a folder, a Parquet file, a "
            f"repository of the Hub (USER/NAME) or a published set{did_you_mean(name, published)}",
            next=f"check the name (the published sets: {lists}), or make a data set",
        )
    return named


def hub_states(
    sets: Iterable[PublishedSet],
) -> Iterator[tuple[hub.HubRepository | None, hub.HubRepository | None]]:
    """Ask the Hub for all sets at once; yield the repository and the cached files of each.

    The first is None if the Hub does not answer, the second if the cache has no file of the last resolved
    commit.
    """

    def state(entry: PublishedSet) -> tuple[hub.HubRepository | None, hub.HubRepository | None]:
        found = None
        with suppress(ToolkitError):
            found = hub.open_repository(entry.repo_id)
        return None if found is None or found.is_cache else found, hub.find_cached(entry.repo_id)

    return run.in_threads(state, sets, _THREADS)
