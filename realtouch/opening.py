"""Opening data sets of real touches, by names: short names, repositories, folders, files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from os import PathLike, fsdecode
from typing import Any, Literal, overload

from realtouch.columns import Damage
from realtouch.dataset import TouchSeqDataset, TouchSingleDataset, TouchStream, dataset_of
from realtouch.integrity import agreeing_files, find_damage, modal_touch_count
from realtouch.kind import KIND
from realtouch.schema import kind_of
from tactile_toolkit.catalog.locate import find_files, find_shards, place_of as place_of_name
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.files import expanded

SHORT_NAMES = {
    name: entry.repo_id.partition("/")[2] for entry in KIND.published for name in (entry.name, *entry.aliases)
}
"""Short name to the name of the published repository, without its owner."""

Name = str | PathLike[str]
Place = str | tuple[str, ...]
"""A path, a repository of the Hub, or several files."""


def place_of(name: Name | Sequence[Name]) -> Place:
    """Return what a name means: a local path, a repository of the Hub, or several files.

    Raises InputError when it is not a name.
    """
    if isinstance(name, (str, PathLike)):
        place = place_of_name(fsdecode(name))
        return str(expanded(place)) if place.startswith("~") else place
    given: Any = name
    is_list = isinstance(given, Iterable) and not isinstance(given, (bytes, bytearray))
    files = list(given) if is_list else [given]
    for file in files:
        if not isinstance(file, (str, PathLike)):
            raise InputError(
                f"{file!r} ({type(file).__name__}) is not a name of a data set; expected a short name "
                "such as 'real-single-64x64', USER/NAME on the Hub, a folder, a Parquet file, or several of "
                "these files"
            )
    return tuple(map(fsdecode, files))


def open_shards(
    place: Place, split: str | None, *, revision: str | None = None, streaming: bool = False
) -> tuple[Shard, ...]:
    """Find the shards of one split of whatever :func:`realtouch.load` understands; InputError without any."""
    if isinstance(place, str):
        return find_shards(place, split, revision=revision, streaming=streaming)
    return find_files(list(place), revision=revision, streaming=streaming)


@overload
def load(
    name: Name | Sequence[Name],
    split: str | None = None,
    streaming: Literal[False] = False,
    revision: str | None = None,
    *,
    on_error: Literal["raise", "skip"] = "raise",
) -> TouchSeqDataset | TouchSingleDataset: ...
@overload
def load(
    name: Name | Sequence[Name],
    split: str | None = None,
    *,
    streaming: Literal[True],
    revision: str | None = None,
    on_error: Literal["raise", "skip"] = "raise",
) -> TouchStream: ...
@overload
def load(
    name: Name | Sequence[Name],
    split: str | None = None,
    streaming: bool = False,
    revision: str | None = None,
    *,
    on_error: Literal["raise", "skip"] = "raise",
) -> TouchSeqDataset | TouchSingleDataset | TouchStream: ...
def load(
    name: Name | Sequence[Name],
    split: str | None = None,
    streaming: bool = False,
    revision: str | None = None,
    *,
    on_error: Literal["raise", "skip"] = "raise",
) -> TouchSeqDataset | TouchSingleDataset | TouchStream:
    """Open a data set of real touches.

    Parameters
    ----------
    name : str, path, or sequence of them
        A short name (see :data:`realtouch.opening.SHORT_NAMES`), any repository of the Hub
        (``USER/NAME[@REVISION]``, ``hf://datasets/USER/NAME[@REVISION]/PATH``), a local folder, a Parquet
        file, or several that belong together. Local data of the same name comes first.
    split : str, optional
        Split to open; only its shards are fetched. May be left out where there is only one.
    streaming : bool
        Return an iterable that reads one shard after another and stores nothing.
    revision : str, optional
        Branch, tag or commit of a Hub repository.
    on_error : "raise" or "skip"
        ``"raise"``: what is damaged raises when it is asked for. ``"skip"``: everything is checked now, as by
        ``realtouch verify``; damaged files and rounds are left out of the data set, damaged touches out of
        its ``touches()``, and listed in ``skipped``. A stream checks each round when it comes to it.

    Returns
    -------
    TouchSeqDataset, TouchSingleDataset or TouchStream; no row is read until it is asked for

    Raises
    ------
    InputError
        No such folder or split, several splits and none named, or no data set of touches.
    IntegrityError
        A file is damaged, a column has a wrong type, or files hold clips and images, or other classes. With
        ``"skip"`` only when no file is left.
    HubError
        The repository cannot be reached or does not exist.
    """
    if on_error not in ("raise", "skip"):
        raise InputError(f"on_error is {on_error!r}; expected 'raise' or 'skip'")
    found = open_shards(place_of(name), split, revision=revision, streaming=streaming)
    left_out: list[Damage] = []
    skips = on_error == "skip"
    files = agreeing_files(found, str(name), left_out if skips else None)
    if not files:  # for what is wrong with the first of them
        agreeing_files(found, str(name))
    # Over all files: one of them may have lost touches of every round.
    expected = modal_touch_count(files) if skips else None
    if streaming:
        kind = kind_of(files[0].schema, files[0].path)
        return TouchStream(
            tuple(files), kind, skip_damage=skips, expected_touches=expected, left_out=left_out
        )
    if not skips:
        return dataset_of(files)
    intact, rows, damage = find_damage(files, expected)
    return dataset_of(intact, rows, [*((None, each) for each in left_out), *damage])
