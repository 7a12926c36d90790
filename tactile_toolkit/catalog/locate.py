"""Where a data set of a given name lies, a local folder, a file or a repository; and of what kind it is."""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeAlias

from tactile_toolkit.errors import InputError, IntegrityError, ToolkitError
from tactile_toolkit.hub.calls import hub_failures, not_cached
from tactile_toolkit.hub.repository import HubName, HubRepository, find_cached, hub_name, open_repository
from tactile_toolkit.kind import DatasetKind, PublishedSet, kinds
from tactile_toolkit.read.columns import class_names
from tactile_toolkit.read.dataset import RecordDataset
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.build import resume_promotion
from tactile_toolkit.store.files import expanded, path_exists, readable
from tactile_toolkit.store.folder import DataFolder, split_uri
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest, without_collecting
from tactile_toolkit.store.names import damaged, is_remote, normalize_uri, scheme_of
from tactile_toolkit.store.origin import read_record
from tactile_toolkit.store.parquet import small_files
from tactile_toolkit.store.shards import (
    DATA_FOLDER,
    ShardFile,
    ShardName,
    files_of_split,
    shard_files,
    unknown_split,
)
from tactile_toolkit.wording import did_you_mean

# The splits of a data set, and what finds the shards of one of them.
_Splits: TypeAlias = tuple[tuple[str, ...], Callable[[str], tuple[Shard, ...]]]

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
    splits, shards_of = _open(name, revision, streaming)
    if split is None:
        split, *further = splits or [_USUAL_SPLIT]
        if further:
            raise InputError(
                f"{_shown(name)} has the splits {', '.join(splits)}; expected one of them",
                next=f"name it, split={split!r} (in a shell --split {split})",
            )
    return shards_of(split)


def splits_of(name: str, *, revision: str | None = None) -> tuple[str, ...]:
    """List the splits of a data set by its name; InputError where it holds no Parquet files."""
    splits, _ = _open(name, revision)
    if not splits:
        raise unknown_split("", (), name)
    return splits


def _open(name: str, revision: str | None, streaming: bool = False) -> _Splits:
    """Return the splits of a data set by its name, and what finds the shards of one of them."""
    place = _found_here(name) or _named_on_hub(name, revision)
    if isinstance(place, DataFolder):
        return _open_folder(place)
    if isinstance(place, str) or _is_file(place):
        shard = ShardName.parse(Path(place if isinstance(place, str) else place.path).name)
        stated = None if shard is None else shard.split

        def file_of(split: str) -> tuple[Shard, ...]:
            # `train` may be what is asked for by default: a file named alone is opened then, whatever it is.
            if split not in (stated or split, _USUAL_SPLIT):
                raise unknown_split(split, (str(stated),), name)
            return find_files([name], revision=revision, streaming=streaming)

        return (stated or _USUAL_SPLIT,), file_of
    repository = open_repository(place.repo_id, place.revision)
    files = repository_shards(repository, place.path)

    def fetched(split: str) -> tuple[Shard, ...]:
        paths = [file.path for file in hub_split(repository, files, split)]
        return _hub_shards(repository, paths, streaming)

    return _splits_in(files), fetched


def find_files(
    names: Sequence[str], *, revision: str | None = None, streaming: bool = False
) -> tuple[Shard, ...]:
    """Find Parquet files that belong together, local or on the Hub, as :func:`find_shards` does."""
    if not names:
        raise InputError("no files given; expected Parquet files of one data set")
    shards: list[Shard] = []
    opened = functools.cache(open_repository)  # one each: its files are of one commit
    for name in names:
        place = _found_here(name) or hub_name(name, revision)
        if isinstance(place, HubName) and _is_file(place):
            shards += _hub_shards(opened(place.repo_id, place.revision), [place.path], streaming)
        elif isinstance(place, str):
            shards.append(Shard(place))
        else:
            raise InputError(f"no file {_shown(name)}; expected Parquet files of one data set")
    return tuple(shards)


def repository_named(name: str, revision: str | None = None) -> HubName:
    """Return the repository that a name, or the short name of a published set, means.

    Raises InputError for other names, and for a part of a repository.
    """
    known = published_set(name)
    named = _named_on_hub(known.repo_id if known else name, revision)
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
    if scheme_of(name) == "hf":
        return None
    if is_remote(name):
        folder = DataFolder(name)
        if name.endswith(_PARQUET):
            return folder.root
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
        is_there = path_exists(place)
    if is_there and place.is_dir():
        return DataFolder(str(place))
    return str(place) if is_there and place.is_file() else None


def _shown(name: str) -> str:
    return repr(name if len(name) <= _LONGEST_SHOWN else f"{name[:_LONGEST_SHOWN]}...")


def _is_file(named: HubName) -> bool:
    return named.path.endswith(_PARQUET)


def _hub_shards(repository: HubRepository, paths: Sequence[str], streaming: bool) -> tuple[Shard, ...]:
    if not streaming:
        return tuple(Shard(str(place)) for place in repository.local_paths(paths))
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


def available_splits(folder: DataFolder) -> tuple[str, ...]:
    """List the splits of a folder: those of its manifest, or else those its file names state."""
    return _open_folder(folder)[0]


def _open_folder(folder: DataFolder) -> _Splits:
    resume_promotion(folder)  # files of two sets lie in one that is being replaced
    manifest = read_manifest(folder)
    if manifest is not None:
        return manifest.splits, functools.partial(_recorded_shards, folder, manifest)
    files = _folder_files(folder)

    def shards_of(split: str) -> tuple[Shard, ...]:
        return tuple(Shard(folder.address(each.path)) for each in files_of_split(files, split, folder.root))

    return _splits_in(files), shards_of


def _splits_in(files: Iterable[ShardFile]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(file.split for file in files))


@without_collecting()
def _recorded_shards(folder: DataFolder, manifest: Manifest, split: str) -> tuple[Shard, ...]:
    root, records = folder.address(), manifest.shards_of(split)
    if not records or len(records) != records[0].shard.count:
        there = [file.path for file in _folder_files(folder) if file.split == split]
        if not (records or there) and manifest.complete:
            raise unknown_split(split, manifest.splits, root)
        raise IntegrityError(
            f"the run that makes {root!r} is not finished ({len(there)} shards of split {split!r} are "
            f"there, {MANIFEST_FILE} lists {len(records)} of them)",
            next="run the same command again, it continues, or download the data set again",
        )
    small: list[tuple[Shard, str] | None] = [None] * len(records)
    for file in small_files(manifest, split):
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
    files = [file for pattern in ("*/*.parquet", "*/*/*.parquet") for file in root.glob(pattern)]
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
            folder.missing_message(MANIFEST_FILE),
            next=f"give the folder of a data set, such as one made by `{kind.made_by}`",
        )
    return manifest


@contextmanager
def specification_read(where: str) -> Iterator[None]:
    """Take a manifest whose specification is not as expected for damaged."""
    try:
        yield
    except (KeyError, TypeError, AttributeError) as error:
        problem = f"its specification is not that of this kind of data set ({type(error).__name__}: {error})"
        raise damaged(where, problem) from error


def published_set(name: str) -> PublishedSet | None:
    """Return a published set by its short name or its repository; None for any other name."""
    entries = (entry for kind in kinds() for entry in kind.published)
    return next((each for each in entries if name in (each.name, each.repo_id, *each.aliases)), None)


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


def states(sets: Iterable[PublishedSet]) -> Iterator[tuple[HubRepository | None, HubRepository | None]]:
    """Ask the Hub for all sets at once; yield what it says of each, and what its cache has.

    None where the Hub gives no answer, and where nothing of the commit last looked at is in the cache.
    """

    def state(entry: PublishedSet) -> tuple[HubRepository | None, HubRepository | None]:
        found = None
        with suppress(ToolkitError):
            found = open_repository(entry.repo_id)
        return None if found is None or found.is_cache else found, find_cached(entry.repo_id)

    return in_threads(state, sets, _THREADS)


def file_fingerprint(shard: Shard) -> dict[str, Any]:
    """Return JSON values that identify the rows of a file; its footer holds the size of every column."""
    folder, name = split_uri(shard.path)
    with folder.open(name) as stream:
        # A Parquet file ends in the length of its footer and four letters.
        size = stream.seek(-8, 2) + 8
        footer_bytes = int.from_bytes(stream.read(4), "little")
        stream.seek(-8 - footer_bytes, 2)
        footer = stream.read(footer_bytes)
    return {
        "file": name,
        "rows": len(shard),
        "bytes": size,
        "footer_sha256": hashlib.sha256(footer).hexdigest(),
    }


def manifest_beside(shard: Shard) -> Manifest | None:
    """Return the manifest of the folder that a shard lies in, where there is one."""
    data, _ = split_uri(shard.path)
    folder, name = split_uri(data.address())
    return read_manifest(folder) if name == DATA_FOLDER else None


def refuse_source(folder: DataFolder, name: str, shards: Iterable[Shard]) -> None:
    """Refuse to write where shards are read, be it by another name or through a link (InputError).

    ``name`` is the data set as the user gave it.
    """
    out, files = folder.address(), [shard.path for shard in shards]
    if not folder.is_local:
        inside = f"{out}/"
        holds = any(file.startswith(inside) for file in files)
        lies_in = inside.startswith(f"{name.rstrip('/')}/")
    else:
        place, home = Path(out).resolve(), expanded(name).resolve()
        # By both paths: files of the Hub's cache are links into another folder.
        named = [Path(file).absolute() for file in files]
        real = [file.resolve() for file in named]
        holds = any(file.is_relative_to(place) for file in real)
        ours = home.is_dir() and place.is_relative_to(home)
        lies_in = ours and any(file.is_relative_to(home) for file in [*real, *named])
    if holds or lies_in:
        raise InputError(
            f"{out!r}, the folder to write, {'holds' if holds else 'lies in'} the source {name!r}; "
            "nothing was changed",
            next="choose a folder outside it",
        )
