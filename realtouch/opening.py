"""Opening data sets of real touches."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike, fspath
from pathlib import Path
from typing import Literal, overload

from dataset_store.errors import InputError
from dataset_store.places import find_shards
from dataset_store.rowgroups import Shard, ShardedTable
from realtouch.dataset import TouchSeqDataset, TouchSingleDataset, TouchStream
from realtouch.names import repository_of
from realtouch.schema import Kind, class_names, kind_of, require_types

__all__ = ["dataset_of", "load", "open_shards"]

Name = str | PathLike[str]


@overload
def load(
    name: Name | Sequence[Name],
    split: str = "train",
    *,
    streaming: Literal[False] = False,
    revision: str | None = None,
    on_error: Literal["raise", "skip"] = "raise",
) -> TouchSeqDataset | TouchSingleDataset: ...
@overload
def load(
    name: Name | Sequence[Name],
    split: str = "train",
    *,
    streaming: Literal[True],
    revision: str | None = None,
    on_error: Literal["raise", "skip"] = "raise",
) -> TouchStream: ...
def load(
    name: Name | Sequence[Name],
    split: str = "train",
    *,
    streaming: bool = False,
    revision: str | None = None,
    on_error: Literal["raise", "skip"] = "raise",
) -> TouchSeqDataset | TouchSingleDataset | TouchStream:
    """Open a data set of real touches.

    Parameters
    ----------
    name : str, path, or sequence of them
        A short name (see :data:`realtouch.names.SHORT_NAMES`), any repository of the Hub (``USER/NAME``), a
        local folder, a Parquet file, or several Parquet files that belong together.
    split : str
        Split to open; only its shards are fetched.
    streaming : bool
        Give an iterable that reads as it goes and keeps nothing, instead of a data set with random access.
    revision : str, optional
        Branch, tag or commit of a Hub repository.
    on_error : "raise" or "skip"
        ``"raise"``: what is damaged raises when it is asked for. ``"skip"``: everything is checked once now
        (as by ``realtouch verify``, decoding every image and frame); damaged rounds are left out of the data
        set, damaged touches out of its ``touches()``, and both are listed in ``skipped``. A stream checks
        each round when it comes to it.

    Returns
    -------
    TouchSeqDataset, TouchSingleDataset or TouchStream
        By what the data set holds. No row is read until it is asked for.

    Raises
    ------
    InputError
        No such folder or split, or no data set of touches.
    IntegrityError
        A file is damaged, or a column has a wrong type.
    HubError
        The repository cannot be reached or does not exist.
    """
    if on_error not in ("raise", "skip"):
        message = f"on_error is {on_error!r}; expected 'raise' or 'skip'"
        raise InputError(message)
    shards = open_shards(name, split, revision=revision, streaming=streaming)
    kind = kind_of(shards[0].schema, str(name))
    for shard in shards:
        require_types(shard.schema, shard.path)
    if streaming:
        return TouchStream(shards, kind, skip_damage=on_error == "skip")
    dataset = dataset_of(shards, kind)
    if on_error == "raise":
        return dataset
    from realtouch.checks import without_damage

    return without_damage(dataset)


def dataset_of(shards: tuple[Shard, ...], kind: Kind) -> TouchSeqDataset | TouchSingleDataset:
    """Return the data set of some shards of one kind."""
    names = class_names(shards[0].schema)
    if kind == "seq":
        return TouchSeqDataset([ShardedTable(shards)], label_names=names)
    return TouchSingleDataset([ShardedTable(shards)], label_names=names)


def open_shards(
    name: Name | Sequence[Name], split: str, *, revision: str | None = None, streaming: bool = False
) -> tuple[Shard, ...]:
    """Find the shards of one split of whatever :func:`load` understands.

    Raises
    ------
    InputError
        Nothing is there.
    """
    if isinstance(name, (str, PathLike)):
        place = repository_of(fspath(name))
        return find_shards(place, split, revision=revision, streaming=streaming)
    files = [Path(fspath(file)).expanduser() for file in name]
    missing = [str(file) for file in files if not file.is_file()]
    if missing or not files:
        found = f"no file {missing[0]!r}" if missing else "no files given"
        message = f"{found}; expected Parquet files of one data set"
        raise InputError(message)
    return tuple(Shard(str(file)) for file in files)
