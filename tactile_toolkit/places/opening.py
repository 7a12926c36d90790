"""Names of data sets: one function resolves them, on this machine, in a store or on the Hub."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, Protocol, TypeAlias, TypeVar, cast, overload

from tactile_toolkit import errors, hub, mesh, read, store
from tactile_toolkit.hub.calls import not_cached
from tactile_toolkit.hub.repository import named_on_hub
from tactile_toolkit.kind import DatasetKind, PublishedSet
from tactile_toolkit.places.place import Place, shards_by_split
from tactile_toolkit.places.split_files import (
    PARQUET,
    USUAL_SPLIT,
    has_shards,
    is_interrupted,
    not_a_set,
    parquet_paths,
    require_some,
    split_of_file,
    splits_by_card,
    splits_by_name,
    unknown_split,
)
from tactile_toolkit.store.building import resume_promotion
from tactile_toolkit.store.files import readable
from tactile_toolkit.store.manifest import DATA_FOLDER

# Depth of folders in which files are searched, and their largest number.
_DEPTH = 4
_MAX_FOLDERS = 1000
Name: TypeAlias = "str | os.PathLike[str]"
"""A folder, a Parquet file, a repository of the Hub or the short name of a published set."""


def open_place(
    name: Name | Place | Sequence[Name],
    *,
    revision: str | None = None,
    config: str | None = None,
    allow_incomplete: bool = False,
) -> Place:
    """Resolve the name of a data set; reads no row.

    Parameters
    ----------
    name : str, path, Place, or sequence of them
        A folder or a Parquet file, local or in an object store (``s3://BUCKET/FOLDER``); a repository of the
        Hub, ``USER/NAME[@REVISION]``, or a folder or file in it, ``hf://datasets/USER/NAME[@REVISION]/PATH``;
        the short name of a published set; or several files that belong together. Local data comes first.
    revision : str, optional
        Branch, tag or commit of a repository.
    config : str, optional
        Configuration, of a data set whose card has several.
    allow_incomplete : bool
        Take the finished shards of a data set whose run is not finished.

    Raises
    ------
    InputError
        Nothing of that name, or no data set; several configurations, or two folders with files of one split.
    IntegrityError
        The manifest is damaged.
    HubError
        The repository cannot be reached or does not exist.
    """
    if isinstance(name, Place):
        return name
    place = _several(name, revision)
    if place is None:
        text = os.fsdecode(cast(Name, name))
        local = _local(_without_short_name(text))
        place = _local_place(text, *local, config) if local else hub_place(text, revision, config)
        if local and revision is not None:
            raise errors.InputError(
                f"{text!r} is not on the Hub and has no revisions; {revision!r} was asked for",
                next="leave it out, or name a repository",
            )
    return replace(place.require_config(config), allow_incomplete=allow_incomplete)


def folder_place(folder: store.DataFolder) -> Place:
    """Return the place of a data set folder."""
    return _local_place(folder.address(), folder, "", None)


def _several(names: object, revision: str | None) -> Place | None:
    """Return the place of several files that belong together, each of any split; None for a single name."""
    if isinstance(names, (str, os.PathLike)):
        return None
    files = [names]
    if isinstance(names, Iterable) and not isinstance(names, (bytes, bytearray)):
        files = list(names)
    if not files:
        raise errors.InputError("no files given; expected Parquet files of one data set")
    opened: dict[tuple[str, str | None], hub.HubRepository] = {}
    opened_files = []
    for file in files:
        if not isinstance(file, (str, os.PathLike)):
            raise errors.InputError(
                f"{file!r} ({type(file).__name__}) is not a name of a data set; expected a short name such "
                "as 'real-single-64x64', USER/NAME on the Hub, a folder, a Parquet file, or several of these "
                "files"
            )
        place = open_place(file, revision=revision)
        if not place.is_file:
            raise errors.InputError(f"{place.name!r} is not a file; expected Parquet files of one data set")
        if place.repository is not None:  # all files of one commit
            key = place.repository.repo_id, place.repository.revision
            place = replace(place, source=opened.setdefault(key, place.repository))
        opened_files.append(place)
    name = ", ".join(place.name for place in opened_files)
    return Place(name, tuple(opened_files), {USUAL_SPLIT: ("",)}, is_file=True)


def _without_short_name(name: str) -> str:
    """Return a name, or nothing if it is the short name of a published set and there is no such data."""
    # Short names have no slash: most names are paths, and need no list of kinds.
    if "/" in name or PublishedSet.named(name) is None:
        return name
    # The folder must hold data: a checkout of the toolkit has a folder called ``mnist3d``, too.
    path = Path(name)
    patterns = (store.MANIFEST_FILE, "*.parquet", f"{DATA_FOLDER}/*.parquet")
    is_data = path.is_file() or any(next(path.glob(pattern), None) for pattern in patterns)
    if is_data:
        return name
    return ""


def _local(name: str) -> tuple[store.DataFolder, str] | None:
    """Return a folder, or the folder of a file and its name, local or in an object store; None otherwise.

    Raises InputError for a missing folder of a store, which can be nothing else.
    """
    if not name or store.scheme_of(name) == "hf":
        return None
    try:
        path = store.local_path(name)
    except errors.InputError:  # an unknown user's home
        return None
    if path is None:
        if name.endswith(PARQUET):
            return store.split_uri(name)
        folder = store.open_folder(name)
        if not folder.exists():
            raise errors.InputError(
                f"{folder.missing_message('data set')}; expected the folder of a data set, or a Parquet file",
                next="check the address",
            )
        return folder, ""
    with readable(name):
        if not store.path_exists(path):
            return None
    if path.is_dir():
        return store.open_folder(str(path)), ""
    if path.is_file():
        return store.open_folder(str(path.parent)), path.name
    return None


def _local_place(name: str, folder: store.DataFolder, file: str, config: str | None) -> Place:
    """Return the place of a file of a folder, or of the folder."""
    if file:
        if folder.is_local and not folder.is_parquet(file):
            raise not_a_set(folder, name, file)
        return Place(name, folder, {split_of_file(file) or USUAL_SPLIT: (file,)}, is_file=True)
    resume_promotion(folder)  # a folder that is being replaced has files of two data sets
    manifest = store.Manifest.so_far(folder)
    if manifest is not None:
        return Place(name, folder, shards_by_split(manifest), manifest, manifest.complete)
    if is_interrupted(folder):
        raise not_a_set(folder, name)
    if folder.exists(store.CARD_FILE):
        named = splits_by_card(folder.read_bytes(store.CARD_FILE), _walked(folder), config, name)
        if named is not None:
            return Place(name, folder, require_some(named, name), config=config)
    in_data = [f"{DATA_FOLDER}/{file_name}" for file_name in folder.names(DATA_FOLDER)]
    if not has_shards(in_data):
        in_data = _walked(folder)
    files = splits_by_name(in_data, name)
    if not files:
        raise not_a_set(folder, name)
    return Place(name, folder, files)


def _walked(folder: store.DataFolder) -> list[str]:
    """List the files in a folder and some levels below; InputError if there are too many folders."""
    files: list[str] = []
    waiting = [("", 0)]
    for count, (inside, depth) in enumerate(waiting):
        if count > _MAX_FOLDERS:
            raise errors.InputError(
                f"{folder.address()!r} holds more than {_MAX_FOLDERS:,} folders; expected a data set",
                next="give the folder of one data set",
            )
        entries = folder.entries(inside)
        if inside and store.MANIFEST_FILE in entries:
            continue  # a data set of its own
        for name, size in entries.items():
            path = f"{inside}/{name}".lstrip("/")
            if size is not None:
                files.append(path)
            elif depth < _DEPTH and not store.is_hidden(name):
                waiting.append((path, depth + 1))
    return files


def hub_place(name: str, revision: str | None, config: str | None) -> Place:
    """Resolve a name of the Hub, or the short name of a published set."""
    named = named_on_hub(name, revision)
    repository = hub.open_repository(named.repo_id, named.revision)
    if named.path.endswith(PARQUET):
        split = split_of_file(named.path.rpartition("/")[2]) or USUAL_SPLIT
        return Place(name, repository, {split: (named.path,)}, is_file=True)
    return repository_place(repository, name, named.path, config)


def repository_place(
    repository: hub.HubRepository, name: str, path: str = "", config: str | None = None
) -> Place:
    """Return the place of a repository of the Hub, or of a folder in it.

    Raises
    ------
    IntegrityError
        The name of a file leads out of a folder; nothing was fetched.
    """
    inside = f"{path}/" if path else ""
    paths = parquet_paths(file_path for file_path in repository.files() if file_path.startswith(inside))
    store.names_inside(paths, f"Hub data set {repository.repo_id!r}")
    manifest = repository.manifest
    if manifest is not None:
        # Uploads keep other files: shards of an earlier data set may be next to these.
        listed = shards_by_split(manifest)
        files = {
            split: tuple(shard_path for shard_path in shard_paths if shard_path in {*paths})
            for split, shard_paths in listed.items()
        }
        return Place(name, repository, files, manifest)
    if paths and store.CARD_FILE in repository.remote and not path:
        card = repository.local_paths((store.CARD_FILE,))[0].read_bytes()
        named = splits_by_card(card, paths, config, name)
        if named is not None:
            if repository.is_cache and not any(named.values()):
                raise not_cached(repository.repo_id, "it")
            return Place(name, repository, require_some(named, name), config=config)
    relative = splits_by_name((file_path.removeprefix(inside) for file_path in paths), name)
    files_by_split = {
        split: tuple(f"{inside}{file_path}" for file_path in held) for split, held in relative.items()
    }
    if not files_by_split:
        if repository.is_cache:
            raise not_cached(repository.repo_id, "it")
        raise unknown_split("", (), name)
    return Place(name, repository, files_by_split)


D = TypeVar("D", bound="read.RecordDataset[Any]", covariant=True)
R = TypeVar("R", bound="read.Record")
_DOC = """Open a data set of {nouns}.

    Parameters
    ----------
    name : str or path
        A folder written by ``{made_by}``, a Parquet file, or a repository of the Hub with the same columns:
        ``USER/NAME``{published}.
    split : str, optional
        Split to open; only its shards are downloaded. Optional if there is only one.
    streaming : bool
        Return an iterable that reads one shard after another and stores nothing, instead of a data set with
        random access.
    revision : str, optional
        Branch, tag or commit of a Hub repository.
    config : str, optional
        Configuration, if the card of the data set has several.

    Returns
    -------
    {dataset} or RecordStream
        Rows are read on demand.

    Raises
    ------
    InputError
        There is no such folder or split, there are several splits and none is named, or the data set is of
        another kind or lacks columns of {nouns}.
    IntegrityError
        The data set is damaged or unfinished.
    HubError
        The repository cannot be reached or does not exist.
    """


class MeshLoader(Protocol[D, R]):
    """The type of a function ``load``: it returns a data set, or with ``streaming`` a stream."""

    @overload
    def __call__(
        self,
        name: Name | Place,
        split: str | None = None,
        *,
        streaming: Literal[False] = False,
        revision: str | None = None,
        config: str | None = None,
    ) -> D: ...
    @overload
    def __call__(
        self,
        name: Name | Place,
        split: str | None = None,
        *,
        streaming: Literal[True],
        revision: str | None = None,
        config: str | None = None,
    ) -> mesh.RecordStream[R]: ...
    @overload
    def __call__(
        self,
        name: Name | Place,
        split: str | None = None,
        *,
        streaming: bool = False,
        revision: str | None = None,
        config: str | None = None,
    ) -> D | mesh.RecordStream[R]: ...


def loader(kind: DatasetKind, dataset: type[D], record: type[R]) -> MeshLoader[D, R]:
    """Return the function ``load`` of a kind, for data sets, or streams, of the class of its records."""

    def load(
        name: Name | Place,
        split: str | None = None,
        *,
        streaming: bool = False,
        revision: str | None = None,
        config: str | None = None,
    ) -> Any:
        place = open_place(name, revision=revision, config=config)
        shards = place.shards(split, kind=kind, streaming=streaming)
        names = mesh.SolidDataset.classes_of(shards, place.name, kind.made_by, kind.class_names)
        if streaming:
            return mesh.RecordStream(shards, record, kind.class_names)
        return dataset(read.ShardedTable(shards), label_names=names)

    published = "".join(f", or ``{known.name}`` for the published one" for known in kind.published)
    words = {"nouns": kind.nouns, "made_by": kind.made_by, "published": published}
    load.__doc__ = _DOC.format(**words, dataset=dataset.__name__)
    load.__module__ = dataset.__module__
    load.__qualname__ = "load"
    return load
