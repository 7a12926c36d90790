"""The published data sets of all kinds: found by name, and how much of them is on this machine."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.hub.cache import commit_of
from tactile_toolkit.hub.repository import HubSnapshot, cached_snapshot, fetch_repo_info
from tactile_toolkit.kind import DatasetKind, PublishedSet, kinds
from tactile_toolkit.store.manifest import MANIFEST_FILE
from tactile_toolkit.store.shards import DATA_FOLDER, shard_files

_THREADS = 8


def published_set(name: str) -> PublishedSet | None:
    """Return a published set by its short name or its repository; None for any other name."""
    return next((entry for _, entry in _named(name)), None)


def kind_that_published(name: str) -> DatasetKind | None:
    """Return the kind of a published set, by its short name or its repository; None for any other name."""
    return next((kind for kind, _ in _named(name)), None)


def _named(name: str) -> Iterator[tuple[DatasetKind, PublishedSet]]:
    for kind in kinds():
        for entry in kind.published:
            if name in (entry.name, entry.repo_id, *entry.aliases):
                yield kind, entry


def place_of(name: str | os.PathLike[str]) -> str:
    """Return the repository of a short name, unless there is a file or a data set folder of that name.

    Any other name is returned as it is.
    """
    name = os.fspath(name)
    # What has a slash is not a short name: most names are paths, and need no list of kinds.
    found = None if "/" in name else published_set(name)
    if found is None:
        return name
    # Data, not any folder of that name: sources of the toolkit lie in one called ``mnist3d``.
    place, patterns = Path(name), (MANIFEST_FILE, "*.parquet", f"{DATA_FOLDER}/*.parquet")
    is_data = place.is_file() or any(next(place.glob(pattern), None) for pattern in patterns)
    return name if is_data else found.repo_id


@dataclass(frozen=True, slots=True)
class SetState:
    """A published set, what of it is in the Hub's cache, and how large it is on the Hub, if that says.

    ``local_splits`` have files in the cache, at the commit last looked at; the licence is as its publishers
    state it, or else as its card on the Hub does.
    """

    published: PublishedSet
    local_bytes: int
    local_splits: tuple[str, ...]
    hub_bytes: int | None
    licence: str | None


def states(sets: Sequence[PublishedSet]) -> list[SetState]:
    """Look up what is local and, for all sets at once and without patience, ask the Hub for sizes."""
    with ThreadPoolExecutor(_THREADS) as pool:
        return list(pool.map(_state, sets))


def _state(entry: PublishedSet) -> SetState:
    found: HubSnapshot | None = None
    with contextlib.suppress(ToolkitError):
        # Of a list, nobody waits for a Hub in trouble.
        found = fetch_repo_info(entry.repo_id, patient=False)
    snapshot = None if found is None or found.is_cache else found
    commit = snapshot.commit if snapshot else commit_of(entry.repo_id, "main")
    here = cached_snapshot(entry.repo_id, commit).files if commit else {}
    splits = tuple(dict.fromkeys(file.split for file in shard_files(here)))
    size_bytes = sum(file.size_bytes for file in snapshot.files.values()) if snapshot else None
    licence = entry.licence or (snapshot.licence if snapshot else None)
    local_bytes = sum(file.size_bytes for file in here.values())
    return SetState(entry, local_bytes, splits, size_bytes, licence)
