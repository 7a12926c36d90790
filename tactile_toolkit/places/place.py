"""What a name stands for: one function opens it, one value says what it is.

Whoever takes the name of a data set takes a :class:`Place` from here on: loaders, commands, copies,
environments. So its kind, its splits, and whether it is finished are decided once, from the data.
"""

from __future__ import annotations

import functools
import os
import shlex
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

from tactile_toolkit import hub, mesh, read, store
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.kind import DatasetKind, is_for_others, kinds
from tactile_toolkit.places.layout import (
    CARD_FILE,
    PARQUET,
    USUAL_SPLIT,
    Splits,
    files_of_split,
    has_shards,
    parquet_paths,
    split_of_file,
    splits_by_card,
    splits_by_name,
    unknown_split,
)
from tactile_toolkit.places.other_files import is_parquet_file, not_a_set
from tactile_toolkit.places.published import kind_of_published, named_on_hub, published_set
from tactile_toolkit.wording import with_count

# Folders below that of a data set in which files are looked for, and how many at most.
_DEPTH = 4
_MOST_FOLDERS = 1000
_COLUMNS_SHOWN = 8

Name: TypeAlias = "str | os.PathLike[str]"
"""A folder, a Parquet file, a repository of the Hub or the short name of a published set."""


@dataclass(frozen=True)
class Place:
    """A data set as a name stands for it; no row is read.

    Attributes
    ----------
    name : str
        In the user's words.
    source : DataFolder, HubRepository or tuple of Place
        Where the files are; several places where several files were named.
    files : dict of str to tuple of str
        Paths in the source of the Parquet files of each split, in order.
    manifest : Manifest or None
        What the toolkit recorded, with what an unfinished run has finished.
    complete : bool
        Whether no run that makes it is under way or was interrupted.
    is_file : bool
        Whether files were named, and no folder: they are opened for whatever split.
    allow_incomplete : bool
        Whether :meth:`shards` gives the finished shards of an unfinished split.
    """

    name: str
    source: store.DataFolder | hub.HubRepository | tuple[Place, ...]
    files: Mapping[str, tuple[str, ...]]
    manifest: store.Manifest | None = None
    complete: bool = True
    is_file: bool = False
    allow_incomplete: bool = False
    _found: dict[tuple[str, bool], tuple[read.Shard, ...]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def splits(self) -> tuple[str, ...]:
        """Splits that have files, in order."""
        return tuple(split for split, paths in self.files.items() if paths)

    @property
    def folder(self) -> store.DataFolder | None:
        """The folder, local or in an object store; None for files and repositories of the Hub."""
        if self.is_file or isinstance(self.source, (hub.HubRepository, tuple)):
            return None
        return self.source

    @property
    def repository(self) -> hub.HubRepository | None:
        """The repository of the Hub; None for folders and files."""
        return self.source if isinstance(self.source, hub.HubRepository) else None

    @property
    def revision(self) -> str | None:
        """Commit of a repository of the Hub."""
        return None if self.repository is None else self.repository.commit

    @property
    def spec(self) -> Mapping[str, Any]:
        """Specification that the manifest states; empty without one."""
        return {} if self.manifest is None else self.manifest.spec

    @property
    def made_by(self) -> Mapping[str, Any]:
        """Specification by which the rows were first made, also of a copy; empty where it is not known."""
        return self.spec.get("source_spec", self.spec) or {}

    @property
    def unfinished(self) -> str:
        """How much of an unfinished data set is there, such as ``"3 of 8 shards"``; else empty."""
        return "" if self.complete or self.manifest is None else self.manifest.progress

    @cached_property
    def kind(self) -> DatasetKind | None:
        """Kind of the data: as the manifest says, or the list of published sets, or the columns.

        None for Parquet files of no kind of the toolkit. Of a set without manifest the first file is opened
        that was asked for, or else the first of all.
        """
        if self.is_kind_stated:
            return self._stated_kind
        try:
            return kind_of_rows(self._first_shard().schema)
        except IntegrityError:
            return None  # who reads the rows names what is wrong with the file

    @property
    def is_kind_stated(self) -> bool:
        """Whether the kind is known without a look into a file."""
        return self.manifest is not None or self._stated_kind is not None

    @cached_property
    def _stated_kind(self) -> DatasetKind | None:
        if self.manifest is not None:
            return next((each for each in kinds() if each.name == self.manifest.kind), None)
        return kind_of_published(self.repository.repo_id) if self.repository is not None else None

    def _first_shard(self) -> read.Shard:
        found = next(iter(self._found.values()), None) or self.shards(self.splits[0])
        return found[0]

    def require(self, kind: DatasetKind, command: str = "") -> Place:
        """Return the place if it holds data of a kind; a relative that is opened alike will do.

        Parameters
        ----------
        kind : DatasetKind
            What is expected.
        command : str
            Command that was given, such as ``"export"``; without one, ``load`` of the package.

        Raises
        ------
        InputError
            It holds another kind, or a manifest names one that is not installed.
        """
        unknown = self.manifest is not None and self._stated_kind is None
        if unknown:
            raise InputError(
                f"{self.name!r} holds a data set of kind {self.spec_kind!r}; expected {kind.content}",
                next="install the package that made it",
            )
        if self.kind is not None:
            require_kind(self.kind, kind, self.name, command)
        else:
            self._require_columns(kind, command)
        return self

    def _require_columns(self, kind: DatasetKind, command: str) -> None:
        """Refuse rows of no kind that have not what a kind needs; damaged files are left to their readers."""
        with suppress(IntegrityError):
            names = read.column_names(self._first_shard().schema)
            if not any(name in names for name in kind.needs):
                shown = ", ".join(names[:_COLUMNS_SHOWN])
                more = "" if len(names) <= _COLUMNS_SHOWN else " and others"
                raise InputError(
                    f"{self.name!r} holds rows of no kind of this toolkit (columns {shown}{more}); "
                    f"`{_asked(kind, command)}` is for {kind.content}, with a column "
                    f"{' or '.join(map(repr, kind.needs))}",
                    next=f"look at a row with `{kind.command} show {shlex.quote(self.name)}`",
                )

    def _refuse_files_for_others(self) -> None:
        if is_for_others(self.manifest):
            raise InputError(
                f"{self.name!r} was made by `{self.spec['operation']}` for other programs; expected a data "
                "set with rows of its kind",
                next="give the data set that it was made of, or open this one with `datasets`",
            )

    @property
    def spec_kind(self) -> str:
        """Kind as the manifest names it; empty without one."""
        return "" if self.manifest is None else self.manifest.kind

    def require_complete(self, split: str | None = None) -> Place:
        """Return the place if it, or one split of it, is finished, or an unfinished one is allowed.

        Raises
        ------
        IntegrityError
            A run that makes it is under way or was interrupted.
        """
        if not (self.complete or self.allow_incomplete or (split is not None and self._is_whole(split))):
            raise self._not_finished()
        return self

    def require_manifest(self, kind: DatasetKind) -> store.Manifest:
        """Return the manifest of a finished folder of a kind.

        Raises
        ------
        InputError
            There is none.
        IntegrityError
            The run that makes the data set is not finished.
        """
        if self.manifest is None or self.folder is None:
            raise InputError(
                f"no {store.MANIFEST_FILE} in {self.name!r}",
                next=f"give the folder of a data set, such as one made by `{kind.made_by}`",
            )
        self.require_complete()
        return self.manifest

    def _is_whole(self, split: str) -> bool:
        if self.manifest is None:
            return True
        records = self.manifest.shards_of(split)
        return bool(records) and len(records) == records[0].shard.count

    def _not_finished(self) -> IntegrityError:
        record = None if self.folder is None else store.read_record(self.folder)
        again = "run the same command again" if record is None else f"download {record.repo_id} there again"
        return IntegrityError(
            f"the run that makes {self.name!r} is not finished ({self.unfinished})",
            next=f"{again}, it continues; or take what is finished with --allow-incomplete "
            "(allow_incomplete=True)",
        )

    def split(self, split: str | None) -> str:
        """Return the split that is meant: one may be left out where there is only one."""
        if split is not None:
            return split
        if not self.splits:
            raise self._not_finished()
        if len(self.splits) > 1:
            raise InputError(
                f"{self.name!r} has the splits {', '.join(self.splits)}; expected one of them",
                next=f"name it, split={self.splits[0]!r} (in a shell --split {self.splits[0]})",
            )
        return self.splits[0]

    def shards(
        self, split: str | None = None, *, kind: DatasetKind | None = None, streaming: bool = False
    ) -> tuple[read.Shard, ...]:
        """Return the shards of one split, fetching them first where they are on the Hub.

        Parameters
        ----------
        split : str, optional
            May be left out where there is only one.
        kind : DatasetKind, optional
            Refuse data of another kind, before anything is fetched where that is known.
        streaming : bool
            Read files of the Hub at their address, piece by piece.

        Raises
        ------
        InputError
            No such split, several and none was named, or another kind.
        IntegrityError
            Files are missing, or the run that makes the split is not finished.
        HubError
            The Hub cannot be reached, or has not such a file.
        """
        if kind is not None and self.is_kind_stated:
            self.require(kind)
            self._refuse_files_for_others()
        chosen = self.split(split)
        found = self._found.get((chosen, streaming))
        if found is None:
            found = self._found.setdefault((chosen, streaming), self._find(chosen, streaming))
        if kind is not None:
            self.require(kind)
        return found

    def all_shards(self) -> dict[str, tuple[read.Shard, ...]]:
        """Return the shards of all splits."""
        return {split: self.shards(split) for split in self.splits}

    def fetched_paths(self) -> set[str]:
        """Return the local paths of all files that :meth:`shards` has fetched from the Hub."""
        parts = self.source if isinstance(self.source, tuple) else (self,)
        return {
            shard.path
            for part in parts
            if part.repository is not None
            for found in part._found.values()
            for shard in found
        }

    def _find(self, split: str, streaming: bool) -> tuple[read.Shard, ...]:
        if isinstance(self.source, tuple):
            every = (place.shards(place.splits[0], streaming=streaming) for place in self.source)
            return tuple(shard for found in every for shard in found)
        if isinstance(self.source, hub.HubRepository):
            return _hub_shards(self.source, self.paths_of(split), streaming)
        if self.manifest is not None:
            return self._recorded_shards(self.source, self.manifest, split)
        return tuple(read.Shard(self.source.address(path)) for path in self.paths_of(split))

    def paths_of(self, split: str) -> tuple[str, ...]:
        """Return the paths of the files of a split; raises as :meth:`shards`."""
        # `train` may be what is asked for by default: a file named alone is opened then, whatever it is.
        if self.is_file and (split == USUAL_SPLIT or split_of_file(self.files[self.splits[0]][0]) is None):
            return self.files[self.splits[0]]
        try:
            return files_of_split(self.files, split, self.name)
        except (InputError, IntegrityError) as error:
            if self.repository is None or not self.repository.is_cache or self.manifest is not None:
                raise
            raise hub.not_cached(self.repository.repo_id, f"split {split!r}") from error

    @store.without_collecting()
    def _recorded_shards(
        self, folder: store.DataFolder, manifest: store.Manifest, split: str
    ) -> tuple[read.Shard, ...]:
        root, records = folder.address(), manifest.shards_of(split)
        if not self._is_whole(split) and not (records and self.allow_incomplete):
            if not records and self.complete:
                raise unknown_split(split, manifest.splits, self.name)
            if self.complete:
                raise IntegrityError(
                    f"{store.MANIFEST_FILE} of {self.name!r} lists {len(records)} of "
                    f"{with_count(records[0].shard.count, 'shards')} of split {split!r}; expected all",
                    next="download or generate the data set again",
                )
            raise self._not_finished()
        # Names were checked when the manifest was read: address(PATH) would do so again for each of 50,000.
        return tuple(
            [
                read.Shard(
                    f"{root}/{record.shard.data_path}",
                    record.rows,
                    size_bytes=record.bytes,
                )
                for record in records
            ]
        )


def _hub_shards(
    repository: hub.HubRepository, paths: Sequence[str], streaming: bool
) -> tuple[read.Shard, ...]:
    if not streaming:
        return tuple(read.Shard(str(place)) for place in repository.local_paths(paths))
    for path in paths:
        repository.file(path)  # a file that is not there is named now, not when it is read
    failures = functools.partial(hub.hub_failures, repository.repo_id, "streaming")
    return tuple(read.Shard(repository.address(path), failures=failures) for path in paths)


def kind_of_rows(schema: Any) -> DatasetKind | None:
    """Return the kind of rows by a column that only it has, or else of meshes by their published classes."""
    names = read.column_names(schema)
    for kind in kinds():
        if any(name.partition(".")[0] in kind.columns for name in names):
            return kind
    if mesh.FACES not in names:
        return None
    classes = read.class_names(schema, ())
    known = (kind for kind in kinds() if kind.published and kind.class_names)
    return next((kind for kind in known if kind.class_names == classes), None)


def require_kind(found: DatasetKind, kind: DatasetKind, name: str, command: str = "") -> None:
    """Refuse a data set of another kind: say what it is, and which command or function is for it.

    Raises
    ------
    InputError
        The two kinds are not opened alike.
    """
    if found.package == kind.package:
        return
    asked, next_step = _asked(kind, command), f"use {found.package}.load({name!r})"
    if command:
        next_step = f"run `{found.command} {found.command_like(command)} {shlex.quote(name)}`"
    raise InputError(f"{name!r} holds {found.content}; `{asked}` is for {kind.content}", next=next_step)


def _asked(kind: DatasetKind, command: str) -> str:
    return f"{kind.command} {command}" if command else f"{kind.package}.load"


def open_place(
    name: Name | Place | Sequence[Name],
    *,
    revision: str | None = None,
    config: str | None = None,
    allow_incomplete: bool = False,
) -> Place:
    """Say what a name stands for; reads no row.

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
    if not isinstance(name, (str, os.PathLike)):
        return _several(name, revision)
    text = os.fsdecode(name)
    local = _local(_without_short_name(text))
    if local is not None:
        found = _file_place(text, *local) if local[1] else _folder_place(text, local[0], config)
    else:
        known = published_set(text)
        found = _hub_place(known.repo_id if known else text, text, revision, config)
    return replace(found, allow_incomplete=allow_incomplete)


def folder_place(folder: store.DataFolder) -> Place:
    """Say what a folder of a data set holds."""
    return _folder_place(folder.address(), folder, None)


def _several(names: Any, revision: str | None) -> Place:
    """Return the place of several files that belong together; each is one of any split."""
    is_list = isinstance(names, Iterable) and not isinstance(names, (bytes, bytearray))
    files = list(names) if is_list else [names]
    if not files:
        raise InputError("no files given; expected Parquet files of one data set")
    for file in files:
        if not isinstance(file, (str, os.PathLike)):
            raise InputError(
                f"{file!r} ({type(file).__name__}) is not a name of a data set; expected a short name "
                "such as 'real-single-64x64', USER/NAME on the Hub, a folder, a Parquet file, or several of "
                "these files"
            )
    opened: dict[Any, hub.HubRepository] = {}
    places = tuple(_of_one_commit(open_place(file, revision=revision), opened) for file in files)
    for place in places:
        if not place.is_file:
            raise InputError(f"{place.name!r} is not a file; expected Parquet files of one data set")
    return Place(", ".join(map(os.fsdecode, files)), places, {USUAL_SPLIT: ("",)}, is_file=True)


def _of_one_commit(place: Place, opened: dict[Any, hub.HubRepository]) -> Place:
    if place.repository is None:
        return place
    key = place.repository.repo_id, place.repository.revision
    return replace(place, source=opened.setdefault(key, place.repository))


def _without_short_name(name: str) -> str:
    """Return a name, but nothing where it is the short name of a published set and no data of that name."""
    # What has a slash is not a short name: most names are paths, and need no list of kinds.
    if "/" in name or published_set(name) is None:
        return name
    # Data, not any folder of that name: sources of the toolkit lie in one called ``mnist3d``.
    place, patterns = Path(name), (store.MANIFEST_FILE, "*.parquet", f"{store.DATA_FOLDER}/*.parquet")
    is_data = place.is_file() or any(next(place.glob(pattern), None) for pattern in patterns)
    return name if is_data else ""


def _local(name: str) -> tuple[store.DataFolder, str] | None:
    """Return a folder, or the folder of a file and its name, local or in an object store; None otherwise.

    Raises InputError for a folder of a store that is not there: nothing else can be meant.
    """
    if not name or store.scheme_of(name) == "hf":
        return None
    if store.is_remote(name):
        if name.endswith(PARQUET):
            return store.split_uri(store.normalize_uri(name))
        folder = store.open_folder(name)
        if not folder.exists():
            raise InputError(
                f"{folder.missing_message('data set')}; expected the folder of a data set, or a Parquet file",
                next="check the address",
            )
        return folder, ""
    try:
        place = store.expanded(store.normalize_uri(name))
    except InputError:  # an unknown user's home
        return None
    with store.readable(name):
        is_there = store.path_exists(place)
    if is_there and place.is_dir():
        return store.open_folder(str(place)), ""
    return (store.open_folder(str(place.parent)), place.name) if is_there and place.is_file() else None


def folder_named(name: str) -> store.DataFolder | None:
    """Return the folder of that name, local or in an object store; None for a file or a name of the Hub."""
    folder, file = _local(name) or (None, "")
    return None if file else folder


def _file_place(name: str, folder: store.DataFolder, file: str) -> Place:
    if folder.is_local and not is_parquet_file(folder, file):
        raise not_a_set(folder, name, file)
    return Place(name, folder, {split_of_file(file) or USUAL_SPLIT: (file,)}, is_file=True)


def _folder_place(name: str, folder: store.DataFolder, config: str | None) -> Place:
    store.resume_promotion(folder)  # files of two sets lie in one that is being replaced
    manifest = store.manifest_so_far(folder)
    if manifest is not None:
        splits = {split: _record_paths(manifest, split) for split in manifest.splits}
        return Place(name, folder, splits, manifest, manifest.complete)
    found: Splits | None = None
    if folder.exists(CARD_FILE):
        found = splits_by_card(folder.read_bytes(CARD_FILE), _walked(folder), config, name)
    if found is None:
        in_data = [f"{store.DATA_FOLDER}/{each}" for each in folder.names(store.DATA_FOLDER)]
        found = splits_by_name(in_data if has_shards(in_data) else _walked(folder), name)
    if not any(found.values()):
        raise not_a_set(folder, name)
    return Place(name, folder, found)


def _record_paths(manifest: store.Manifest, split: str) -> tuple[str, ...]:
    return tuple(record.shard.data_path for record in manifest.shards_of(split))


def _walked(folder: store.DataFolder) -> list[str]:
    """List the files in a folder and some levels below; InputError where there are too many folders."""
    files: list[str] = []
    waiting = [("", 0)]
    for count, (inside, depth) in enumerate(waiting):
        if count > _MOST_FOLDERS:
            raise InputError(
                f"{folder.address()!r} holds more than {_MOST_FOLDERS:,} folders; expected a data set",
                next="give the folder of one data set",
            )
        entries = folder.entries(inside)
        if inside and store.MANIFEST_FILE in entries:
            continue  # a data set of its own
        for name, size in entries.items():
            path = f"{inside}/{name}" if inside else name
            if size is not None:
                files.append(path)
            elif depth < _DEPTH and not store.is_hidden(name):
                waiting.append((path, depth + 1))
    return files


def _hub_place(name: str, shown: str, revision: str | None, config: str | None) -> Place:
    named = named_on_hub(name, revision)
    repository = hub.open_repository(named.repo_id, named.revision)
    if named.path.endswith(PARQUET):
        file = {split_of_file(named.path.rpartition("/")[2]) or USUAL_SPLIT: (named.path,)}
        return Place(shown, repository, file, is_file=True)
    return repository_place(repository, shown, named.path, config)


def repository_place(
    repository: hub.HubRepository, name: str, path: str = "", config: str | None = None
) -> Place:
    """Say what a repository of the Hub, or a folder in it, holds.

    Raises
    ------
    IntegrityError
        It has a file whose name leads out of a folder; nothing of it was fetched.
    """
    inside = f"{path}/" if path else ""
    paths = parquet_paths(each for each in repository.files() if each.startswith(inside))
    store.names_inside(paths, f"Hub data set {repository.repo_id!r}")
    manifest = repository.manifest
    if manifest is not None:
        # An upload removes nothing that it was not asked to: shards of an older layout may lie next to these.
        listed = {split: _record_paths(manifest, split) for split in manifest.splits}
        files = {split: tuple(each for each in found if each in {*paths}) for split, found in listed.items()}
        return Place(name, repository, files, manifest)
    found: Splits | None = None
    if paths and CARD_FILE in repository.remote and not path:
        card = repository.local_paths((CARD_FILE,))[0].read_bytes()
        found = splits_by_card(card, paths, config, name)
    if found is None:
        relative = splits_by_name((each.removeprefix(inside) for each in paths), name)
        found = {split: tuple(f"{inside}{each}" for each in held) for split, held in relative.items()}
    if not any(found.values()):
        raise hub.not_cached(repository.repo_id, "it") if repository.is_cache else unknown_split("", (), name)
    return Place(name, repository, found)
