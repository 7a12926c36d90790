"""The shards of a repository of the Hub, fetched or streamed."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from tactile_toolkit import hub, read


def hub_shards(
    repository: hub.HubRepository, paths: Sequence[str], streaming: bool
) -> tuple[read.Shard, ...]:
    """Return files of a repository as shards, fetched or, for ``streaming``, by their addresses."""
    if not streaming:
        return tuple(read.Shard(str(place)) for place in repository.local_paths(paths))
    for path in paths:
        repository.file(path)  # a file that is not there is named now, not when it is read
    failures = partial(hub.hub_failures, repository.repo_id, "streaming")
    return tuple(read.Shard(repository.address(path), failures=failures) for path in paths)
