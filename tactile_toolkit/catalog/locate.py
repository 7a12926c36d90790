"""Where a data set of a given name lies, a local folder, a file or a repository; and of what kind it is."""

from __future__ import annotations

import functools
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactile_toolkit.errors import InputError, IntegrityError, ToolkitError
from tactile_toolkit.hub.calls import hub_failures, not_cached
from tactile_toolkit.hub.repository import HubName, HubRepository, find_cached, hub_name, open_repository
from tactile_toolkit.kind import DatasetKind, PublishedSet, kinds
from tactile_toolkit.read.columns import class_names
from tactile_toolkit.read.dataset import RecordDataset
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.derived import small_files
from tactile_toolkit.store.files import expanded, path_exists, readable
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.job import manifest_so_far
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest, without_collecting
from tactile_toolkit.store.names import is_remote, normalize_uri, scheme_of
from tactile_toolkit.store.origin import read_record
from tactile_toolkit.store.overwrite import resume_promotion
from tactile_toolkit.store.shards import (
    DATA_FOLDER,
    ShardFile,
    ShardName,
    files_of_split,
    shard_files,
    unknown_split,
)
from tactile_toolkit.wording import did_you_mean

_LONGEST_SHOWN = 200
_USUAL_SPLIT = "train"
_PARQUET = ".parquet"
_THREADS = 8


def find_shards(
    name: str, split: str | None, *, revision: str | None = None, streaming: bool = False
) -> tuple[Shard, ...]:
    """Find the shards of one split, fetching them first where they are on the Hub; by default the only split.

    ``name`` is a folder or a Parquet file, local or in an object store (``s3://BUCKET/FOLDER``), or a
    repository of the Hub: ``USER/NAME[@REVISION]``, or the address of it, or of a folder or file in it,
    ``hf://datasets/USER/NAME[@REVISION][/PATH]``. What lies in a store is read piece by piece. A file whose
    name states no split is taken for whatever split, and any file for ``train``. With ``streaming``, shards
    have remote addresses that are read piece by piece. Raises InputError (no such folder or split),
    IntegrityError (a damaged manifest, an interrupted run) or HubError.
    """
    place = _found_here(name) or _named_on_hub(name, revision)
    if isinstance(place, DataFolder):
        with without_collecting():
            return _folder_shards(place, split)
    if isinstance(place, str) or _is_file(place):
        # `train` may be what is asked for by default: a file named alone is opened then, whatever its split.
        found = _split_in_name(place)
        if split not in (None, found or split, _USUAL_SPLIT):
            raise unknown_split(str(split), (str(found),), name)
        return find_files([name], revision=revision, streaming=streaming)
    repository = open_repository(place.repo_id, place.revision)
    files = repository_shards(repository, place.path)
    chosen = _split_of([file.split for file in files], split, name)
    paths = [file.path for file in hub_split(repository, files, chosen)]
    return _hub_shards(repository, paths, streaming)


def find_files(
    names: Sequence[str], *, revision: str | None = None, streaming: bool = False
) -> tuple[Shard, ...]:
    """Find Parquet files that belong together, local or on the Hub, as :func:`find_shards` does."""
    if not names:
        raise InputError("no files given; expected Parquet files of one data set")
    shards: list[Shard] = []
    repositories: dict[tuple[str, str | None], HubRepository] = {}  # one each: its files are of one commit
    for name in names:
        place = _found_here(name) or hub_name(name, revision)
        if isinstance(place, HubName) and _is_file(place):
            key = place.repo_id, place.revision
            repositories[key] = repositories.get(key) or open_repository(*key)
            shards += _hub_shards(repositories[key], [place.path], streaming)
        elif isinstance(place, str):
            shards.append(Shard(place))
        else:
            raise InputError(f"no file {_shown(name)}; expected Parquet files of one data set")
    return tuple(shards)


def repository_named(name: str, revision: str | None = None) -> HubName:
    """Return the repository that a name means; InputError for other names, and for a part of one."""
    named = _named_on_hub(name, revision)
    if named.path:
        raise InputError(
            f"{name!r} is a part of a repository; expected all of it", next=f"leave {named.path!r} out"
        )
    return named


def _named_on_hub(name: str, revision: str | None) -> HubName:
    named = hub_name(name, revision)
    if named is None:
        published = {entry.name: kind.command for kind in kinds() for entry in kind.published}
        lists = ", ".join(f"`{command} list`" for command in dict.fromkeys(published.values()))
        raise InputError(
            f"{_shown(name)} does not exist; expected a folder, a Parquet file, a repository of the Hub "
            f"(USER/NAME) or a published set{did_you_mean(name, published)}",
            next=f"check the name (the published sets: {lists}), or make a data set",
        )
    return named


def folder_named(name: str) -> DataFolder | None:
    """Return the folder of that name, local or in an object store; None for a file or a name of the Hub.

    Raises InputError for a folder of a store that is not there: nothing else can be meant.
    """
    found = _found_here(name)
    return found if isinstance(found, DataFolder) else None


def _found_here(name: str) -> str | DataFolder | None:
    """Return a Parquet file by its path or a folder, local or in an object store; None for anything else."""
    if is_remote(name):
        if scheme_of(name) == "hf":
            return None
        if name.endswith(_PARQUET):
            return normalize_uri(name)
        folder = DataFolder(name)
        if not folder.exists():
            raise InputError(
                f"{folder.missing_message('data set')}; expected the folder of a data set, or a Parquet file",
                next="check the address",
            )
        return folder
    try:
        place = expanded(normalize_uri(name))
    except InputError:  # an unknown user's home
        return None
    with readable(name):
        if not path_exists(place):
            return None
    if place.is_dir():
        return DataFolder(str(place))
    return str(place) if place.is_file() else None


def _shown(name: str) -> str:
    return repr(name if len(name) <= _LONGEST_SHOWN else f"{name[:_LONGEST_SHOWN]}...")


def _is_file(named: HubName) -> bool:
    return named.path.endswith(_PARQUET)


def _split_in_name(place: str | HubName) -> str | None:
    """Return the split that the name of a file states, such as ``test-00000-of-00002.parquet``."""
    shard = ShardName.parse(Path(place.path if isinstance(place, HubName) else place).name)
    return None if shard is None else shard.split


def _split_of(known: Sequence[str], split: str | None, name: str) -> str:
    """Return the split that was named, or else the only one; InputError where there are several."""
    if split is not None:
        return split
    only, *further = dict.fromkeys(known or [_USUAL_SPLIT])
    if further:
        raise InputError(
            f"{_shown(name)} has the splits {', '.join([only, *further])}; expected one of them",
            next=f"name it, split={only!r} (in a shell --split {only})",
        )
    return only


def _hub_shards(repository: HubRepository, paths: Sequence[str], streaming: bool) -> tuple[Shard, ...]:
    if not streaming:
        return tuple(Shard(str(place)) for place in repository.fetch(paths))
    for path in paths:
        repository.file(path)  # a file that is not there is named now, not when it is read
    failures = functools.partial(hub_failures, repository.repo_id, "streaming")
    return tuple(Shard(repository.address(path), failures=failures) for path in paths)


def hub_split(repository: HubRepository, files: list[ShardFile], split: str) -> list[ShardFile]:
    """Return the files of one split of a repository; HubError for what may be there but is not cached."""
    try:
        return files_of_split(files, split, repository.repo_id)
    except (InputError, IntegrityError) as error:
        if not repository.is_cache or repository.manifest is not None:
            raise
        raise not_cached(repository.repo_id, f"split {split!r}") from error


def repository_shards(repository: HubRepository, folder: str = "") -> list[ShardFile]:
    """Sort the Parquet files of a repository, or of a folder in it, by split."""
    inside = f"{folder}/" if folder else ""
    files = [file for file in shard_files(repository.files()) if file.path.startswith(inside)]
    if repository.manifest is None:
        return files
    # An upload removes nothing that it was not asked to: shards of an older layout may lie next to these.
    listed = {record.shard.data_path for record in repository.manifest.shards}
    return [file for file in files if file.path in listed]


def splits_of(name: str, *, revision: str | None = None) -> tuple[str, ...]:
    """List the splits of a data set by its name; InputError where it holds no Parquet files."""
    place = _found_here(name) or _named_on_hub(name, revision)
    if isinstance(place, DataFolder):
        splits = available_splits(place)
    elif isinstance(place, str) or _is_file(place):
        splits = (_split_in_name(place) or _USUAL_SPLIT,)
    else:
        files = repository_shards(open_repository(place.repo_id, place.revision), place.path)
        splits = tuple(dict.fromkeys(file.split for file in files))
    if not splits:
        raise unknown_split("", (), name)
    return splits


def available_splits(folder: DataFolder) -> tuple[str, ...]:
    """List the splits of a folder: those of its manifest, or else those its file names state."""
    manifest = read_manifest(folder)
    if manifest is not None:
        return manifest.splits
    return tuple(dict.fromkeys(file.split for file in _folder_files(folder)))


def _folder_shards(folder: DataFolder, split: str | None) -> tuple[Shard, ...]:
    resume_promotion(folder)  # files of two sets lie in one that is being replaced
    manifest, root = read_manifest(folder), folder.address()
    if manifest is None:
        found = _folder_files(folder)
        chosen = _split_of([file.split for file in found], split, root)
        return tuple(Shard(folder.address(file.path)) for file in files_of_split(found, chosen, root))
    chosen = _split_of(manifest.splits, split, root)
    records = manifest.shards_of(chosen)
    if not records or len(records) != records[0].shard.count:
        there = [file.path for file in _folder_files(folder) if file.split == chosen]
        if not (records or there) and manifest.complete:
            raise unknown_split(chosen, manifest.splits, root)
        raise IntegrityError(
            f"the run that makes {root!r} is not finished ({len(there)} shards of split {chosen!r} are "
            f"there, {MANIFEST_FILE} lists {len(records)} of them)",
            next="run the same command again, it continues, or download the data set again",
        )
    small: list[tuple[Shard, str] | None] = [None] * len(records)
    for file in small_files(manifest, chosen):
        if file.path in (manifest.files or ()):
            first = file.records[0].shard.index
            entry = (Shard(folder.address(file.path), file.rows), file.made_of)
            small[first : first + len(file.records)] = [entry] * len(file.records)
    # Names were checked when the manifest was read: address(PATH) would do so again for each of 50,000.
    return tuple(
        [
            Shard(f"{root}/{record.shard.data_path}", record.rows, small=entry, size_bytes=record.bytes)
            for record, entry in zip(records, small, strict=True)
        ]
    )


def _folder_files(folder: DataFolder) -> list[ShardFile]:
    nested = [f"{DATA_FOLDER}/{name}" for name in folder.names(DATA_FOLDER)]
    found = shard_files([*nested, *folder.names()])
    if found or not folder.is_local:
        return found
    # In folders called as their split: default/train/0000.parquet of the Hub's branch refs/convert/parquet.
    root = Path(folder.address())
    files = [file for pattern in ("[!.]*/*.parquet", "[!.]*/[!.]*/*.parquet") for file in root.glob(pattern)]
    return shard_files(file.relative_to(root).as_posix() for file in files if file.stem.isdigit())


def kind_of_meshes(schema: Any) -> DatasetKind | None:
    """Return the kind of meshes by a column that only it has, or else by the classes of its published set."""
    for kind in kinds():
        if any(column in schema.names for column in kind.columns):
            return kind
    names = class_names(schema, ())
    return next((kind for kind in kinds() if names and kind.published and kind.class_names == names), None)


def require_kind(kind: DatasetKind, command: str, name: str, datasets: Iterable[RecordDataset[Any]]) -> None:
    """Refuse meshes of another kind than a command is for, as far as their columns say so; reads no row.

    ``name`` is the data set in the user's words. Raises InputError.
    """
    for dataset in datasets:
        other = kind_of_meshes(dataset._table.schema)
        if other is not None and other is not kind:
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
    for name in [".", *sorted(each.name for each in folder.iterdir() if each.is_dir())]:
        try:
            manifest = manifest_so_far(DataFolder(str(folder / name)))
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
        found = open_repository(entry.repo_id)
        if not found.is_cache:
            size_bytes = sum(file.size_bytes for file in found.remote.values())
            licence = licence or found.licence
    cached = find_cached(entry.repo_id)
    here = cached.remote if cached else {}
    splits = tuple(dict.fromkeys(file.split for file in shard_files(here)))
    local_bytes = sum(file.size_bytes for file in here.values())
    return SetState(entry, local_bytes, splits, size_bytes, licence)
