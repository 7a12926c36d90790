"""The published Tactile MNIST data sets: short names, where they lie, and under which terms."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from tactile_toolkit.catalog.locate import shard_files
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.hub.snapshot import HubSnapshot, RepositoryCache, look_at
from tactile_toolkit.store.manifest import MANIFEST_FILE
from tactile_toolkit.store.shards import DATA_FOLDER

__all__ = ["PUBLISHED", "PublishedSet", "SetState", "place_of", "published_set", "published_sets", "states"]

_OWNER = "TimSchneider42"
_PAPER = "Schneider et al., Tactile MNIST: Benchmarking Active Tactile Perception, 2025"
_HAND = "Beaulac & Rosenthal, doi 10.1007/s42979-022-01494-2, 2022"
_THREADS = 8


@dataclass(frozen=True, slots=True)
class PublishedSet:
    """A published data set.

    Attributes
    ----------
    name : str
        Short name.
    repo_id : str
        Repository of the Hub.
    room : str
        Command line that it belongs to: ``mnist3d``, ``starstruck`` or ``realtouch``.
    content : str
        What it holds, in a few words.
    citation : str
        Whom to cite.
    licence : str or None
        As its publishers state it; None where only the card on the Hub says.
    """

    name: str
    repo_id: str
    room: str
    content: str
    citation: str
    licence: str | None = None


def _set(name: str, repository: str, room: str, content: str, licence: str | None = None) -> PublishedSet:
    citation = f"{_PAPER}; {_HAND}" if room == "mnist3d" or "digits" in content else _PAPER
    return PublishedSet(name, f"{_OWNER}/tactile-mnist-{repository}", room, content, citation, licence)


_REAL_LICENCE = "CC BY 2.0"

# Counts: Tactile MNIST paper and the documentation of the published loaders.
PUBLISHED = (
    _set("mnist3d", "mnist3d", "mnist3d", "13,580 meshes of digits in 5 splits"),
    _set("starstruck", "starstruck", "starstruck", "3,300 scenes with one to three stars"),
    _set(
        "real-seq",
        "touch-real-seq-t256-320x240",
        "realtouch",
        "153,600 clips of touches of printed digits, 320 x 240 px",
        _REAL_LICENCE,
    ),
    _set(
        "real-single-320x240",
        "touch-real-single-t256-320x240",
        "realtouch",
        "153,600 images of touches of printed digits, 320 x 240 px",
        _REAL_LICENCE,
    ),
    _set(
        "real-single-64x64",
        "touch-real-single-t256-64x64",
        "realtouch",
        "153,600 images of touches of printed digits, 64 x 64 px",
        _REAL_LICENCE,
    ),
    _set(
        "syn-single-320x240",
        "touch-syn-single-t32-320x240",
        "realtouch",
        "rendered touches of digits, 32 per round, 320 x 240 px",
    ),
    _set(
        "syn-single-64x64",
        "touch-syn-single-t32-64x64",
        "realtouch",
        "rendered touches of digits, 32 per round, 64 x 64 px",
    ),
    _set(
        "starstruck-syn-single-320x240",
        "touch-starstruck-syn-single-t32-320x240",
        "realtouch",
        "rendered touches of scenes, 32 per round, 320 x 240 px",
    ),
    _set(
        "starstruck-syn-single-64x64",
        "touch-starstruck-syn-single-t32-64x64",
        "realtouch",
        "rendered touches of scenes, 32 per round, 64 x 64 px",
    ),
)
"""All of them."""

_ALIASES = {"real-single": "real-single-320x240"}


def published_sets(room: str) -> tuple[PublishedSet, ...]:
    """Return the published sets of one command line."""
    return tuple(entry for entry in PUBLISHED if entry.room == room)


def published_set(name: str) -> PublishedSet | None:
    """Return a published set by its short name or its repository; None for any other name."""
    name = _ALIASES.get(name, name)
    return next((entry for entry in PUBLISHED if name in (entry.name, entry.repo_id)), None)


def place_of(name: str) -> str:
    """Return the repository of a short name, unless there is a file or a data set folder of that name.

    Any other name is returned as it is.
    """
    found = published_set(name)
    if found is None or _is_data(Path(name)):
        return name
    return found.repo_id


def _is_data(place: Path) -> bool:
    """Tell data from any other folder of that name: sources of the toolkit lie in one called ``mnist3d``."""
    if place.is_file() or (place / MANIFEST_FILE).is_file():
        return True
    return any(next(place.glob(pattern), None) for pattern in ("*.parquet", f"{DATA_FOLDER}/*.parquet"))


@dataclass(frozen=True, slots=True)
class SetState:
    """A published set, what of it is on this machine, and how large it is on the Hub.

    Attributes
    ----------
    published : PublishedSet
        The set.
    local_bytes : int
        Size of what is in the Hub's cache.
    local_splits : tuple of str
        Splits of which files are in the cache, at the commit last looked at.
    hub_bytes : int or None
        Size on the Hub; None when it did not say.
    licence : str or None
        As its publishers state it, or else as its card on the Hub does.
    """

    published: PublishedSet
    local_bytes: int
    local_splits: tuple[str, ...]
    hub_bytes: int | None
    licence: str | None


def states(sets: Sequence[PublishedSet]) -> list[SetState]:
    """Look up what is local and, for all sets at once and without patience, ask the Hub for sizes."""
    with ThreadPoolExecutor(_THREADS) as pool:
        snapshots = list(pool.map(_snapshot, sets))
    return [_state(entry, snapshot) for entry, snapshot in zip(sets, snapshots, strict=True)]


def _snapshot(entry: PublishedSet) -> HubSnapshot | None:
    try:
        found = look_at(entry.repo_id, patient=False)
    except ToolkitError:
        return None
    return None if found.is_cache else found


def _state(entry: PublishedSet, snapshot: HubSnapshot | None) -> SetState:
    cache = RepositoryCache(entry.repo_id)
    commit = snapshot.commit if snapshot else cache.commit_of("main")
    paths = list(cache.files(commit)) if commit else []
    splits = tuple(dict.fromkeys(file.split for file in shard_files(paths)))
    size = sum(file.size_bytes for file in snapshot.files.values()) if snapshot else None
    licence = entry.licence or (snapshot.licence if snapshot else None)
    return SetState(entry, cache.size_bytes(), splits, size, licence)
