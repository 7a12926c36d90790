"""Data sets of touches by name: one split to read, or the files of all splits."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Literal, overload

import pyarrow as pa

from realtouch import contact, kind
from realtouch.touches import damage, datasets, schema
from tactile_toolkit import catalog, errors, places, read, run, store

_NAMES_SHOWN = 12
_READERS = 4  # threads that read footers
_IMAGES_PER_MEDIA: dict[schema.Kind, int] = {"seq": 64, "single": 1}  # by size: clips are a few dozen images

SHORT_NAMES = {
    name: entry.repo_id.partition("/")[2]
    for entry in kind.KIND.published
    for name in (entry.name, *entry.aliases)
}
"""Short name to the name of the published repository, without its owner."""


@overload
def load(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    streaming: Literal[False] = False,
    revision: str | None = None,
    *,
    config: str | None = None,
) -> datasets.TouchSeqDataset | datasets.TouchSingleDataset: ...
@overload
def load(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    *,
    streaming: Literal[True],
    revision: str | None = None,
    config: str | None = None,
) -> datasets.TouchStream: ...
@overload
def load(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    streaming: bool = False,
    revision: str | None = None,
    *,
    config: str | None = None,
) -> datasets.TouchSeqDataset | datasets.TouchSingleDataset | datasets.TouchStream: ...
def load(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    streaming: bool = False,
    revision: str | None = None,
    *,
    config: str | None = None,
) -> datasets.TouchSeqDataset | datasets.TouchSingleDataset | datasets.TouchStream:
    """Open a data set of real touches.

    Parameters
    ----------
    name : str, path, or sequence of them
        A short name (see :data:`realtouch.SHORT_NAMES`), any repository of the Hub
        (``USER/NAME[@REVISION]``, ``hf://datasets/USER/NAME[@REVISION]/PATH``), a local folder, a Parquet
        file, or several that belong together. Local data of the same name comes first.
    split : str, optional
        Split to open; only its shards are fetched. May be left out where there is only one.
    streaming : bool
        Return an iterable that reads one shard after another and stores nothing.
    revision : str, optional
        Branch, tag or commit of a Hub repository.
    config : str, optional
        Configuration, of a data set whose card has several.

    Returns
    -------
    TouchSeqDataset, TouchSingleDataset or TouchStream; rows are read on access

    Raises
    ------
    InputError
        No such folder or split, several splits and none named, or no data set of touches.
    IntegrityError
        A file is damaged, a column has a wrong type, or files hold clips and images, or other
        classes.
    HubError
        The repository cannot be reached or does not exist.
    """
    data_set = places.open_place(name, revision=revision, config=config)
    files = agreeing_files(data_set.shards(split, kind=kind.KIND, streaming=streaming), data_set.name)
    if streaming:
        return datasets.TouchStream(tuple(files), schema.media_kind(files[0].schema, files[0].path))
    return datasets.dataset_of(files)


def agreeing_files(
    shards: Iterable[read.Shard], name: str, left_out: list[damage.Damage] | None = None
) -> list[read.Shard]:
    """Return the files of a data set that can be read and agree with the first of them.

    The damage of the other files is added to ``left_out``. Without such a list it is raised: InputError for a
    file without touches, IntegrityError for a file that is damaged or differs.
    """
    files: list[read.Shard] = []
    for shard in shards:
        try:
            if not files:
                schema.media_kind(shard.schema, name)
            schema.require_types(shard)
            if files:
                _require_agreement(shard, files)
            files.append(shard)
        except (errors.InputError, errors.IntegrityError) as error:
            if left_out is None or (isinstance(error, errors.InputError) and not files):
                raise
            left_out.append(damage.unreadable_file(shard.path, error))
    return files


def _require_agreement(shard: read.Shard, files: Sequence[read.Shard]) -> None:
    """Refuse a file of another kind, or with other classes, than those before it; IntegrityError."""
    first = schema.media_kind(files[0].schema, files[0].path)
    if schema.media_kind(shard.schema, shard.path) != first:
        raise errors.IntegrityError(
            f"{shard.path!r}, field {schema.MEDIA_COLUMN[first]!r}: the column is not there; expected it as "
            f"in {files[0].path!r}",
            next="open files of one data set together",
        )
    names = shard.class_names
    expected = schema.stated_class_names(files)
    if names is not None and expected is not None and names != expected:
        own_names, first_names = (", ".join(some[:_NAMES_SHOWN]) for some in (names, expected))
        raise errors.IntegrityError(
            f"{shard.path!r}, field 'label': the classes are named {own_names}; expected {first_names} "
            "as in the files before it",
            next="open them apart, or make them again",
        )


def parts_of(data_set: places.Place, split: str | None) -> tuple[str, ...]:
    """Return the named split, or all splits."""
    return data_set.splits if split is None else (split,)


@dataclass(frozen=True)
class Source:
    """A data set to convert: its name as the user gave it, its kind, and the shards of each split."""

    name: str
    shards: Mapping[str, tuple[read.Shard, ...]]
    kind: schema.Kind
    unfinished: str = ""

    @classmethod
    def open(cls, name: places.Name | places.Place, split: str | None = None) -> Source:
        """Find the splits of a data set (or the one given), fetching them first where they are on the Hub.

        Reads footers. Raises as :func:`realtouch.load`.
        """
        data_set = places.open_place(name).require_complete(split)
        splits = parts_of(data_set, split)
        shards = {part: data_set.shards(part, kind=kind.KIND) for part in splits}
        for files in shards.values():
            deque(run.in_threads(schema.require_types, files, _READERS), maxlen=0)
        return cls(
            data_set.name,
            shards,
            schema.media_kind(shards[splits[0]][0].schema, data_set.name),
            data_set.unfinished,
        )

    @property
    def schema(self) -> pa.Schema:
        """Arrow schema of the first shard."""
        return next(iter(self.shards.values()))[0].schema

    @property
    def class_names(self) -> tuple[str, ...]:
        """Name of each class; empty without labels."""
        return schema.class_names_of(self._files())

    def require_frame(self, method: contact.ContactMethod) -> None:
        """Raise InputError unless the frames of clips can be chosen by a method."""
        schema.require_poses_for(method, read.column_types(self.schema), self.name)

    def manifest(self) -> store.Manifest | None:
        """Return the manifest next to the shards, if any."""
        return catalog.manifest_beside(next(iter(self.shards.values()))[0].path)

    def row_bytes(self) -> int:
        """Return the size of a row unpacked, on average over the data set; at least 1."""
        chunks = chain.from_iterable(run.in_threads(read.Shard.column_chunks, self._files(), _READERS))
        size: int = sum(chunk.total_uncompressed_size for chunk in chunks)
        return max(size // max(sum(map(len, self._files())), 1), 1)

    def media_bytes(self) -> int:
        """Return the size of an image or clip, on average over the data set; at least 1."""
        sizes = run.in_threads(
            partial(_media_bytes, f"{schema.MEDIA_COLUMN[self.kind]}."), self._files(), _READERS
        )
        count, size = map(sum, zip(*sizes, strict=True))
        return max(size // max(count, 1), 1)

    def image_bytes(self) -> int:
        """Return the approximate size of an image, or of a frame of a clip; at least 1."""
        return self.media_bytes() // _IMAGES_PER_MEDIA[self.kind] or 1

    def _files(self) -> Iterator[read.Shard]:
        return chain.from_iterable(self.shards.values())

    def fingerprint(self) -> dict[str, list[dict[str, str | int]]]:
        """Return JSON values that identify the rows: names, sizes and footers of the files.

        The footer holds offset and size of every column chunk: other content gives another footer, and
        reading 28 GB to plan a conversion would cost minutes.
        """
        return {
            split: list(run.in_threads(read.Shard.fingerprint, files, _READERS))
            for split, files in self.shards.items()
        }


def _media_bytes(column: str, shard: read.Shard) -> tuple[int, int]:
    """Return the number of values of a column of bytes, and the size of the column unpacked."""
    chosen = [chunk for chunk in shard.column_chunks() if chunk.path_in_schema.startswith(column)]
    values = sum(chunk.num_values for chunk in chosen if chunk.path_in_schema.endswith(".bytes"))
    return values, sum(chunk.total_uncompressed_size for chunk in chosen)
