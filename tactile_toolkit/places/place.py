"""The data set that a name refers to: its kind, its splits and their shards, and whether it is finished.

Whatever takes the name of a data set (loaders, commands, copies, environments) takes a :class:`Place` from
:func:`~tactile_toolkit.places.open_place`. So these facts are decided once, from the data.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, partial

from tactile_toolkit import errors, hub, mesh, read, run, store, wording
from tactile_toolkit.hub.calls import hub_failures, not_cached
from tactile_toolkit.hub.repository import find_cached
from tactile_toolkit.kind import DatasetKind, PublishedSet, is_for_others
from tactile_toolkit.places.split_files import (
    USUAL_SPLIT,
    files_of_split,
    split_of_file,
    splits_by_name,
    unknown_split,
)
from tactile_toolkit.store.verification import DownloadRecord
from tactile_toolkit.value_types import JsonDict, JsonObject

_COLUMNS_SHOWN = 8
_TAKE_FINISHED = "; or take what is finished with --allow-incomplete (allow_incomplete=True)"
_THREADS = 8


@dataclass(frozen=True)
class Place:
    """The data set that a name refers to; no row is read.

    Attributes
    ----------
    name : str
        As the user gave it.
    source : DataFolder, HubRepository or tuple of Place
        Location of the files; several places if several files were named.
    files : dict of str to tuple of str
        Paths in the source of the Parquet files of each split, in order.
    manifest : Manifest or None
        Manifest, with the finished shards of an unfinished run.
    complete : bool
        False while the run that makes it is under way, or after it was interrupted.
    is_file : bool
        Whether files were named, not a folder; they are opened as any split.
    allow_incomplete : bool
        Whether :meth:`shards` gives the finished shards of an unfinished split.
    config : str or None
        Requested configuration of the data card.
    """

    name: str
    source: store.DataFolder | hub.HubRepository | tuple[Place, ...]
    files: Mapping[str, tuple[str, ...]]
    manifest: store.Manifest | None = None
    complete: bool = True
    is_file: bool = False
    allow_incomplete: bool = False
    config: str | None = None
    _shards: dict[tuple[str, bool], tuple[read.Shard, ...]] = field(
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

    @cached_property
    def download(self) -> DownloadRecord | None:
        """Record of a downloaded folder; None for all others, IntegrityError if it is damaged."""
        return None if self.folder is None else store.read_download_record(self.folder)

    @property
    def revision(self) -> str | None:
        """Commit of a repository of the Hub."""
        return None if self.repository is None else self.repository.commit

    @property
    def spec(self) -> JsonObject:
        """Specification that the manifest states; empty without one."""
        return {} if self.manifest is None else self.manifest.spec

    @property
    def made_by(self) -> JsonObject:
        """Specification by which the rows were first made, also of a copy; empty if it is not known."""
        return {} if self.manifest is None else self.manifest.made_by

    @property
    def unfinished(self) -> str:
        """Finished shards of an unfinished data set, such as ``"3 of 8 shards"``; otherwise empty."""
        if self.complete or self.manifest is None:
            return ""
        return self.manifest.progress

    @cached_property
    def kind(self) -> DatasetKind | None:
        """Kind of the data, by the manifest, the list of published sets, or the columns.

        None for Parquet files of no kind of the toolkit. Without a manifest, the first file is opened.
        """
        if self.is_kind_stated:
            return self._stated_kind
        return _kind_of(self._first_shard())

    @property
    def is_kind_stated(self) -> bool:
        """Whether the kind is known without opening a file."""
        return self.manifest is not None or self._stated_kind is not None

    @cached_property
    def _stated_kind(self) -> DatasetKind | None:
        if self.manifest is not None:
            return DatasetKind.named(self.manifest.kind)
        repository = self.repository or self.download
        return None if repository is None else DatasetKind.of_published(repository.repo_id)

    def choose_kind(self, name: str | None = None) -> DatasetKind:
        """Return the named kind if the columns fit it; without a name, the recognised one.

        Raises InputError if the kind is not known and none is named, and if the named one does not fit.
        """
        recognised = self.kind
        named = DatasetKind.named(name)
        if named is None and name is not None:
            expected = ", ".join(kind.name for kind in DatasetKind.installed())
            raise errors.InputError(f"is {name!r}; expected one of {expected}", field="kind")
        if named is not None:
            self.require(named, "--kind")
            return named
        if recognised is not None:
            return recognised
        columns = read.column_names(self._first_shard().schema)
        fitting = [
            kind.name for kind in DatasetKind.installed() if any(column in columns for column in kind.needs)
        ]
        if self.manifest is not None or not fitting:
            shown = ", ".join(columns[:_COLUMNS_SHOWN])
            raise errors.InputError(
                f"{self.name!r} holds rows of no kind of this toolkit (columns {shown})",
                next=f"show a row with `tactile show {shlex.quote(self.name)}`",
            )
        raise errors.InputError(
            f"{self.name!r} has the columns of several kinds, so that its kind is not known",
            next=f"add --kind {' or --kind '.join(fitting)}",
        )

    def _first_shard(self) -> read.Shard:
        shards = next(iter(self._shards.values()), None)
        return (shards or self.shards(self.splits[0]))[0]

    def require(self, kind: DatasetKind, asked: str = "", shard: read.Shard | None = None) -> Place:
        """Return the place if it holds data of a kind, or of one that is opened by the same package.

        Parameters
        ----------
        kind : DatasetKind
            Expected kind.
        asked : str
            Command of the user, such as ``"realtouch check"``; without one, ``load`` of the package.
        shard : Shard, optional
            File whose rows count if the kind is not stated; by default the first.

        Raises
        ------
        InputError
            It holds another kind, or a manifest names one that is not installed.
        """
        if isinstance(self.source, tuple):
            for part in self.source:
                part.require(kind, asked)
            return self
        recognised = self.kind if shard is None or self.is_kind_stated else _kind_of(shard)
        if recognised is not None:
            require_kind(recognised, kind, self.name, asked)
        elif self.manifest is not None and self.manifest.kind != kind.name:
            raise errors.InputError(
                f"{self.name!r} holds a data set of kind {self.manifest.kind!r}; expected {kind.content}",
                next="install the package that made it",
            )
        else:
            self._require_columns(shard or self._first_shard(), kind, asked)
        return self

    def require_meshes(self, asked: str) -> Place:
        """Return the place if it holds meshes of some kind, or rows of no kind, whose columns are not read.

        ``asked`` is a command, such as ``"tactile-sim generate"``, or a function. Raises InputError.
        """
        if self.kind is not None and mesh.FACES not in self.kind.needs:
            raise wrong_kind(self.kind, self.name, asked, "meshes")
        self._refuse_files_for_others()
        return self

    def _require_columns(self, shard: read.Shard, kind: DatasetKind, asked: str) -> None:
        """Refuse rows without the columns that a kind needs; readers report damaged files."""
        with suppress(errors.IntegrityError):
            names = read.column_names(shard.schema)
            if not any(name in names for name in kind.needs):
                shown = ", ".join(names[:_COLUMNS_SHOWN])
                if len(names) > _COLUMNS_SHOWN:
                    shown += " and others"
                raise errors.InputError(
                    f"{self.name!r} holds rows of no kind of this toolkit (columns {shown}); "
                    f"`{asked or kind.package + '.load'}` is for {kind.content}, with a column "
                    f"{' or '.join(map(repr, kind.needs))}",
                    next=f"show a row with `tactile show {shlex.quote(self.name)}`",
                )

    def require_config(self, config: str | None) -> Place:
        """Return the place if its files follow from the requested configuration; else raise InputError."""
        if self.config == config:
            return self
        raise errors.InputError(
            f"{self.name!r} has no configurations, {config!r} was asked for", next="leave it out"
        )

    def _refuse_files_for_others(self) -> None:
        if is_for_others(self.manifest):
            raise errors.InputError(
                f"{self.name!r} was made by `{self.spec['operation']}` for other programs; expected a data "
                "set with rows of its kind",
                next="give the data set that it was made of, or open this one with `datasets`",
            )

    def require_complete(self, split: str | None = None, *, may_take: bool = True) -> Place:
        """Return the place if it, or one split of it, is finished, or an unfinished one is allowed.

        ``may_take`` is whether the command has an option to allow one, for the message.

        Raises
        ------
        IntegrityError
            A run that makes it is under way or was interrupted.
        """
        is_taken = self.allow_incomplete and self.splits  # some of its shards are finished
        if not (self.complete or is_taken or (split is not None and self._is_whole(split))):
            raise errors.IntegrityError(*self._not_finished_words(may_take=may_take))
        return self

    def require_finished(self, wrong: Sequence[str]) -> None:
        """Raise UnfinishedError if the only finding of a check is that the run is not finished.

        ``wrong`` are the files of all findings.
        """
        if not self.complete and list(wrong) == [store.MANIFEST_FILE]:
            raise errors.UnfinishedError(*self._not_finished_words(may_take=False))

    def require_manifest(self, kind: DatasetKind) -> store.Manifest:
        """Return the manifest of a finished folder; ``kind`` is for the message.

        Raises
        ------
        InputError
            There is none.
        IntegrityError
            The run that makes the data set is not finished.
        """
        if self.manifest is None or self.folder is None:
            raise errors.InputError(
                f"no {store.MANIFEST_FILE} in {self.name!r}",
                next=f"give the folder of a data set, such as one made by `{kind.made_by}`",
            )
        self.require_complete(may_take=False)
        return self.manifest

    def _is_whole(self, split: str) -> bool:
        if self.manifest is None:
            return True
        records = self.manifest.shards_of(split)
        return bool(records) and len(records) == records[0].shard.count

    def _not_finished_words(self, *, may_take: bool) -> tuple[str, str]:
        """Return what is not finished, and the next step."""
        otherwise = _TAKE_FINISHED if may_take and not self.allow_incomplete else ""
        again = "run the same command again"
        if self.download is not None:
            again = f"download {self.download.repo_id} there again"
        what = f"the run that makes {self.name!r} is not finished ({self.unfinished})"
        return what, f"{again}, it continues{otherwise}"

    def split(self, split: str | None) -> str:
        """Return a split, or the only one of a finished data set if none is named."""
        if split is not None:
            return split
        self.require_complete()
        if not self.splits:
            raise unknown_split("", (), self.name)
        if len(self.splits) > 1:
            raise errors.InputError(
                f"{self.name!r} has the splits {', '.join(self.splits)}; expected one of them",
                next=f"name it, split={self.splits[0]!r} (in a shell --split {self.splits[0]})",
            )
        return self.splits[0]

    def chosen_splits(self, split: str | None) -> tuple[str, ...]:
        """Return one split, or all if none is named; InputError if there is no such split."""
        if split is None:
            return self.splits
        if split not in self.files and not self.is_file:
            self.paths_of(split)
        return (split,)

    def shards(
        self, split: str | None = None, *, kind: DatasetKind | None = None, streaming: bool = False
    ) -> tuple[read.Shard, ...]:
        """Return the shards of one split, fetching them first where they are on the Hub.

        Parameters
        ----------
        split : str, optional
            May be omitted if there is only one.
        kind : DatasetKind, optional
            Refuse data of another kind, before anything is fetched if possible.
        streaming : bool
            Read files of the Hub at their address, piece by piece.

        Raises
        ------
        InputError
            No such split, several and none was named, or another kind.
        IntegrityError
            Files are missing, or the run that makes the split is not finished.
        HubError
            The Hub cannot be reached, or has no such file.
        """
        if kind is not None and self.is_kind_stated:
            self.require(kind)
            self._refuse_files_for_others()
        chosen = self.split(split)
        if (chosen, streaming) not in self._shards:
            self._shards[chosen, streaming] = self._find(chosen, streaming)
        if kind is not None:
            self.require(kind, shard=self._shards[chosen, streaming][0])
        return self._shards[chosen, streaming]

    def all_shards(self) -> dict[str, tuple[read.Shard, ...]]:
        """Return the shards of all splits."""
        return {split: self.shards(split) for split in self.splits}

    def fetched_paths(self) -> set[str]:
        """Return the local paths of all files that :meth:`shards` has fetched from the Hub."""
        if isinstance(self.source, tuple):
            return set().union(*(part.fetched_paths() for part in self.source))
        if self.repository is None:
            return set()
        return {shard.path for shards in self._shards.values() for shard in shards}

    def _find(self, split: str, streaming: bool) -> tuple[read.Shard, ...]:
        if isinstance(self.source, tuple):
            every = (place.shards(place.splits[0], streaming=streaming) for place in self.source)
            return tuple(shard for shards in every for shard in shards)
        if isinstance(self.source, hub.HubRepository):
            return hub_shards(self.source, self.paths_of(split), streaming)
        if self.manifest is not None:
            return self._recorded_shards(self.source, self.manifest, split)
        return tuple(read.Shard(self.source.address(path)) for path in self.paths_of(split))

    def paths_of(self, split: str) -> tuple[str, ...]:
        """Return the paths of the files of a split; raises as :meth:`shards`."""
        # `train` may be the default of a caller: then a single named file is opened, whatever its split.
        if self.is_file and (split == USUAL_SPLIT or split_of_file(self.files[self.splits[0]][0]) is None):
            return self.files[self.splits[0]]
        try:
            return files_of_split(self.files, split, self.name)
        except (errors.InputError, errors.IntegrityError) as error:
            if self.repository is None or not self.repository.is_cache or self.manifest is not None:
                raise
            raise not_cached(self.repository.repo_id, f"split {split!r}") from error

    @store.without_collecting()
    def _recorded_shards(
        self, folder: store.DataFolder, manifest: store.Manifest, split: str
    ) -> tuple[read.Shard, ...]:
        root = folder.address()
        records = manifest.shards_of(split)
        if not self._is_whole(split) and not (records and self.allow_incomplete):
            if not records and self.complete:
                raise unknown_split(split, manifest.splits, self.name)
            if self.complete:
                raise errors.IntegrityError(
                    f"{store.MANIFEST_FILE} of {self.name!r} lists {len(records)} of "
                    f"{wording.with_count(records[0].shard.count, 'shards')} of split {split!r}; "
                    "expected all",
                    next="download or generate the data set again",
                )
            raise errors.IntegrityError(*self._not_finished_words(may_take=True))
        # Names were checked when the manifest was read; address(PATH) would check each of 50,000 again.
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


def shards_by_split(manifest: store.Manifest) -> dict[str, tuple[str, ...]]:
    """Return the paths of the recorded shards of each split."""
    return {
        split: tuple(record.shard.data_path for record in manifest.shards_of(split))
        for split in manifest.splits
    }


def hub_shards(
    repository: hub.HubRepository, paths: Sequence[str], streaming: bool
) -> tuple[read.Shard, ...]:
    """Return files of a repository as shards, fetched or, for ``streaming``, by their addresses."""
    if not streaming:
        return tuple(read.Shard(str(local_path)) for local_path in repository.local_paths(paths))
    for path in paths:
        repository.file(path)  # a file that is not there is named now, not when it is read
    failures = partial(hub_failures, repository.repo_id, "streaming")
    return tuple(read.Shard(repository.address(path), failures=failures) for path in paths)


def _kind_of(shard: read.Shard) -> DatasetKind | None:
    """Return the kind of the rows of a file; None if it is damaged, which reading the rows reports."""
    with suppress(errors.IntegrityError):
        names = read.column_names(shard.schema)
        return DatasetKind.of_columns(names, partial(read.class_names, shard.schema, ()))
    return None


def require_kind(held: DatasetKind, kind: DatasetKind, name: str, asked: str = "") -> None:
    """Refuse a data set of another kind; the message names the command or function for it.

    Raises
    ------
    InputError
        The two kinds are not opened by the same package.
    """
    if held.package == kind.package:
        return
    raise wrong_kind(held, name, asked or f"{kind.package}.load", kind.content)


def wrong_kind(held: DatasetKind, name: str, asked: str, content: str) -> errors.InputError:
    """Return the error for data of a kind; ``asked``, a command or option, is for other ``content``."""
    next_step = f"use {held.package}.load({name!r})"
    if " " in asked or asked.startswith("-"):
        next_step = f"show what it holds with `tactile info {shlex.quote(name)}`"
    return errors.InputError(f"{name!r} holds {held.content}; `{asked}` is for {content}", next=next_step)


def published_sets() -> Iterator[JsonDict]:
    """Ask the Hub for all published sets at once; yield what each holds and what is here, as JSON values.

    ``hub_bytes`` is None if the Hub does not answer. ``local_splits`` have files in the cache.
    """

    def state(known: PublishedSet) -> JsonDict:
        licence = known.licence
        hub_bytes = None
        with suppress(errors.ToolkitError):
            answer = hub.open_repository(known.repo_id)
            if not answer.is_cache:
                licence = licence or answer.licence
                hub_bytes = answer.size_bytes
        cached = find_cached(known.repo_id)
        local_bytes = 0 if cached is None else cached.size_bytes
        return {
            "name": known.name,
            "repository": known.repo_id,
            "content": known.content,
            "citation": known.citation,
            "licence": licence,
            "hub_bytes": hub_bytes,
            "local_bytes": local_bytes,
            "local_splits": list(splits_by_name(cached.remote, known.repo_id))
            if cached and local_bytes
            else [],
        }

    return run.in_threads(
        state, [known for kind in DatasetKind.installed() for known in kind.published], _THREADS
    )
