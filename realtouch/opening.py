"""Opening data sets of real touches."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from os import PathLike, fsdecode
from pathlib import Path
from typing import Literal, overload

from realtouch.dataset import TouchSeqDataset, TouchSingleDataset, TouchStream, dataset_of
from realtouch.integrity.agreement import require_alike
from realtouch.names import Name, Place, repository_of
from tactile_toolkit.catalog.locate import find_files, find_shards
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.touch.schema import kind_of

__all__ = ["load", "open_shards", "place_of"]


@overload
def load(
    name: Name | Sequence[Name],
    split: str = "train",
    streaming: Literal[False] = False,
    revision: str | None = None,
    *,
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
@overload
def load(
    name: Name | Sequence[Name],
    split: str,
    streaming: Literal[True],
    revision: str | None = None,
    *,
    on_error: Literal["raise", "skip"] = "raise",
) -> TouchStream: ...
@overload
def load(
    name: Name | Sequence[Name],
    split: str = "train",
    streaming: bool = False,
    revision: str | None = None,
    *,
    on_error: Literal["raise", "skip"] = "raise",
) -> TouchSeqDataset | TouchSingleDataset | TouchStream: ...
def load(
    name: Name | Sequence[Name],
    split: str = "train",
    streaming: bool = False,
    revision: str | None = None,
    *,
    on_error: Literal["raise", "skip"] = "raise",
) -> TouchSeqDataset | TouchSingleDataset | TouchStream:
    """Open a data set of real touches.

    Parameters
    ----------
    name : str, path, or sequence of them
        A short name (see :data:`realtouch.names.SHORT_NAMES`), any repository of the Hub
        (``USER/NAME[@REVISION]``), a local folder, a Parquet file, or several Parquet files that belong
        together; files and folders of the Hub as ``hf://datasets/USER/NAME[@REVISION]/PATH``. Local data of
        the same name comes first.
    split : str
        Split to open; only its shards are fetched.
    streaming : bool
        Give an iterable that reads as it goes and keeps nothing, instead of a data set with random access.
    revision : str, optional
        Branch, tag or commit of a Hub repository.
    on_error : "raise" or "skip"
        ``"raise"``: what is damaged raises when it is asked for. ``"skip"``: everything is checked once now
        (as by ``realtouch verify``, decoding every image and frame); files and rows that cannot be read and
        damaged rounds are left out of the data set, damaged touches out of its ``touches()``, and all of them
        are listed in ``skipped``. A stream checks each round when it comes to it.

    Returns
    -------
    TouchSeqDataset, TouchSingleDataset or TouchStream
        By what the data set holds. No row is read until it is asked for.

    Raises
    ------
    InputError
        No such folder or split, or no data set of touches.
    IntegrityError
        A file is damaged, a column has a wrong type, or files do not belong together: some hold clips and
        others images, or their classes are named otherwise. With ``"skip"`` only when no file is left.
    HubError
        The repository cannot be reached or does not exist.
    """
    if on_error not in ("raise", "skip"):
        message = f"on_error is {on_error!r}; expected 'raise' or 'skip'"
        raise InputError(message)
    place = place_of(name)
    shards = open_shards(place, split, revision=revision, streaming=streaming)
    if on_error == "skip":
        from realtouch.integrity.skip import load_undamaged

        return load_undamaged(shards, place, streaming=streaming)
    require_alike(shards, str(name))
    kind = kind_of(shards[0].schema, str(name))
    return TouchStream(shards, kind) if streaming else dataset_of(shards, kind)


def place_of(name: Name | Sequence[Name]) -> Place:
    """Return what a name means: a local path, a repository of the Hub, or several files.

    Raises
    ------
    InputError
        It is no name.
    """
    if isinstance(name, (str, PathLike)):
        return _at_home(repository_of(fsdecode(name)))
    return tuple(_file_names(name))


def _at_home(name: str) -> str:
    try:
        return str(Path(name).expanduser()) if name.startswith("~") else name
    except RuntimeError:  # the home of somebody unknown; refused where it is opened
        return name


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
        place = repository_of(fsdecode(name))
        return find_shards(place, split, revision=revision, streaming=streaming)
    return find_files(_file_names(name), revision=revision, streaming=streaming)


def _file_names(names: object) -> list[str]:
    """Return names of files as text; whatever else was given for a name of a data set is refused here."""
    if isinstance(names, (bytes, bytearray)) or not isinstance(names, Iterable):
        raise _no_name(names)
    files = list(names)
    for file in files:
        if not isinstance(file, (str, PathLike)):
            raise _no_name(file)
    return [fsdecode(file) for file in files]


def _no_name(found: object) -> InputError:
    return InputError(
        f"{found!r} ({type(found).__name__}) is no name of a data set; expected a short name such as "
        "'real-single-64x64', USER/NAME on the Hub, a folder, a Parquet file, or several of these files"
    )
