"""Opening data sets of real touches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, overload

from realtouch.dataset import TouchSeqDataset, TouchSingleDataset, TouchStream, dataset_of
from realtouch.integrity.agreement import TouchFiles, usual_touch_count
from realtouch.integrity.skip import find_damage
from realtouch.names import Name, open_shards, place_of
from tactile_toolkit.errors import InputError


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
    split: str | None,
    streaming: Literal[True],
    revision: str | None = None,
    *,
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
        A short name (see :data:`realtouch.names.SHORT_NAMES`), any repository of the Hub
        (``USER/NAME[@REVISION]``), a local folder, a Parquet file, or several Parquet files that belong
        together; files and folders of the Hub as ``hf://datasets/USER/NAME[@REVISION]/PATH``. Local data of
        the same name comes first.
    split : str, optional
        Split to open; only its shards are fetched. May be left out where there is only one.
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
        No such folder or split, several splits and none named, or no data set of touches.
    IntegrityError
        A file is damaged, a column has a wrong type, or files do not belong together: some hold clips and
        others images, or their classes are named otherwise. With ``"skip"`` only when no file is left.
    HubError
        The repository cannot be reached or does not exist.
    """
    if on_error not in ("raise", "skip"):
        raise InputError(f"on_error is {on_error!r}; expected 'raise' or 'skip'")
    place = place_of(name)
    found = open_shards(place, split, revision=revision, streaming=streaming)
    files = TouchFiles(str(name))
    if on_error == "raise":
        for shard in found:
            files.add(shard)
        shards = tuple(files.shards)
        return TouchStream(shards, files.kind) if streaming else dataset_of(shards, files.kind)
    left_out = files.add_undamaged(found, at_least_one=True)
    # Over all files: one of them may have lost touches of every round.
    expected = usual_touch_count(files.shards)
    if streaming:
        return TouchStream(
            tuple(files.shards), files.kind, skip_damage=True, expected_touches=expected, left_out=left_out
        )
    whole, rows, damage = find_damage(files.shards, expected)
    return dataset_of(whole, files.kind, rows, [*((None, each) for each in left_out), *damage])
