"""Which data sets there are, published or in a folder, and of which kind one is."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactile_toolkit.catalog.locate import folder_named
from tactile_toolkit.errors import InputError, IntegrityError, ToolkitError
from tactile_toolkit.hub.repository import HubRepository, cached_snapshot
from tactile_toolkit.kind import DatasetKind, PublishedSet, kinds
from tactile_toolkit.mesh.columns import class_names
from tactile_toolkit.read.dataset import RecordDataset
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.job import manifest_so_far
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest
from tactile_toolkit.store.origin import read_record
from tactile_toolkit.store.shards import DATA_FOLDER, shard_files

_THREADS = 8


def kind_of_meshes(schema: Any) -> DatasetKind | None:
    """Return the kind of meshes by a column that only it has, or else by the classes of its published set."""
    for kind in kinds():
        if any(column in schema.names for column in kind.columns):
            return kind
    names = class_names(schema, ())
    return next((kind for kind in kinds() if names and kind.published and kind.class_names == names), None)


def require_kind(kind: DatasetKind, command: str, name: str, datasets: Iterable[RecordDataset[Any]]) -> None:
    """Refuse a data set of another kind than a command is for, as far as it says of what kind it is.

    Reads no row; ``name`` is the data set in the user's words. Raises InputError.
    """
    folder = folder_named(name)
    manifest = None if folder is None else read_manifest(folder)
    if manifest is None:
        schemas = (dataset._table.schema for dataset in datasets)
        # What does not say of what kind it is may well be of this one.
        other: DatasetKind | None = next(filter(None, map(kind_of_meshes, schemas)), kind)
    else:
        other = next((each for each in kinds() if each.name == manifest.kind), None)
    if other is None:
        kind.refuse_other(manifest, name)
    elif other is not kind:
        raise InputError(
            f"{name!r} holds {other.nouns}; `{kind.command} {command}` is for {kind.nouns}",
            next=f"run `{other.command} {command} {name}`",
        )


def finished_manifest(kind: DatasetKind, folder: DataFolder) -> Manifest | None:
    """Read the manifest of a folder; None where there is no manifest.

    Raises InputError for another kind or an unfinished run, IntegrityError for a damaged manifest.
    """
    manifest = read_manifest(folder)
    kind.refuse_other(manifest, folder.address())
    if manifest is not None and not manifest.complete:
        record = read_record(folder)
        again = "run the same command again" if record is None else f"download {record.repo_id} there again"
        raise InputError(
            f"the run that fills {folder.address()!r} is not finished",
            next=f"{again}, it continues where it stopped",
        )
    return manifest


def require_manifest(kind: DatasetKind, folder: DataFolder) -> Manifest:
    """Read the manifest of a finished folder, which has to be there; raises as :func:`finished_manifest`."""
    manifest = finished_manifest(kind, folder)
    if manifest is None:
        raise InputError(
            f"{folder.missing_message(MANIFEST_FILE)}",
            next=f"give the folder of a data set, such as one made by `{kind.made_by}`",
        )
    return manifest


@contextmanager
def specification_read(where: str) -> Iterator[None]:
    """Take a manifest whose specification is not as expected for damaged."""
    try:
        yield
    except (KeyError, TypeError, AttributeError) as error:
        raise IntegrityError(
            f"the specification in {where!r} is not that of a data set of this kind ({type(error).__name__}: "
            f"{error})",
            next="download or generate the data set again",
        ) from error


@dataclass(frozen=True, slots=True)
class LocalSet:
    """A data set folder, as its manifest states it; ``state`` is finished, unfinished, or what is wrong."""

    name: str
    kind: str
    splits: str
    rows: int
    bytes: int
    state: str


def local_sets(folder: Path) -> list[LocalSet]:
    """Return the data sets in a folder, and itself where it is one, by name; InputError where there is none.

    Reads manifests only.
    """
    if not folder.is_dir():
        raise InputError(
            f"{DataFolder(str(folder)).missing_message('data sets')}",
            next="give a folder with data set folders",
        )
    found = []
    for place in [folder, *sorted(each for each in folder.iterdir() if each.is_dir())]:
        name = "." if place == folder else place.name
        try:
            manifest = manifest_so_far(DataFolder(str(place)))
        except ToolkitError as error:
            found.append(LocalSet(name, "", "", 0, 0, str(error)))
            continue
        if manifest is not None:
            table = manifest.split_table()
            rows, size = (sum(held[each] for held in table.values()) for each in ("rows", "bytes"))
            state = "finished" if manifest.complete else "unfinished"
            found.append(LocalSet(name, manifest.kind, ", ".join(table), rows, size, state))
    return found


def published_set(name: str) -> PublishedSet | None:
    """Return a published set by its short name or its repository; None for any other name."""
    entries = (entry for kind in kinds() for entry in kind.published)
    return next((each for each in entries if name in (each.name, each.repo_id, *each.aliases)), None)


def kind_that_published(name: str) -> DatasetKind | None:
    """Return the kind of a published set, by its short name or its repository; None for any other name."""
    entry = published_set(name)
    return next((kind for kind in kinds() if entry in kind.published), None)


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
    """Look up what is local and, for all sets at once, ask the Hub for sizes."""
    return list(in_threads(_state, sets, _THREADS))


def _state(entry: PublishedSet) -> SetState:
    size_bytes, licence = None, entry.licence
    with suppress(ToolkitError):
        found = HubRepository(entry.repo_id).snapshot
        if not found.is_cache:
            size_bytes = sum(file.size_bytes for file in found.files.values())
            licence = licence or found.licence
    cached = cached_snapshot(entry.repo_id, "main")
    here = cached.files if cached else {}
    splits = tuple(dict.fromkeys(file.split for file in shard_files(here)))
    local_bytes = sum(file.size_bytes for file in here.values())
    return SetState(entry, local_bytes, splits, size_bytes, licence)
