"""Opening data sets of real touches, by names: short names, repositories, folders, files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, overload

from realtouch.columns import Damage
from realtouch.dataset import TouchSeqDataset, TouchSingleDataset, TouchStream, dataset_of
from realtouch.integrity import agreeing_files, find_damage, modal_touch_count
from realtouch.kind import KIND
from realtouch.schema import media_kind
from tactile_toolkit import places
from tactile_toolkit.errors import InputError

SHORT_NAMES = {
    name: entry.repo_id.partition("/")[2] for entry in KIND.published for name in (entry.name, *entry.aliases)
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
    on_error: Literal["raise", "skip"] = "raise",
) -> TouchSeqDataset | TouchSingleDataset: ...
@overload
def load(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    *,
    streaming: Literal[True],
    revision: str | None = None,
    config: str | None = None,
    on_error: Literal["raise", "skip"] = "raise",
) -> TouchStream: ...
@overload
def load(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    streaming: bool = False,
    revision: str | None = None,
    *,
    config: str | None = None,
    on_error: Literal["raise", "skip"] = "raise",
) -> TouchSeqDataset | TouchSingleDataset | TouchStream: ...
def load(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    streaming: bool = False,
    revision: str | None = None,
    *,
    config: str | None = None,
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
    config : str, optional
        Configuration, of a data set whose card has several.
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
    place = places.open_place(name, revision=revision, config=config)
    found = place.shards(split, kind=KIND, streaming=streaming)
    left_out: list[Damage] = []
    skips = on_error == "skip"
    files = agreeing_files(found, place.name, left_out if skips else None)
    if not files:  # for what is wrong with the first of them
        agreeing_files(found, place.name)
    # Over all files: one of them may have lost touches of every round.
    expected = modal_touch_count(files) if skips else None
    if streaming:
        kind = media_kind(files[0].schema, files[0].path)
        return TouchStream(
            tuple(files), kind, skip_damage=skips, expected_touches=expected, left_out=left_out
        )
    if not skips:
        return dataset_of(files)
    intact, rows, damage = find_damage(files, expected)
    return dataset_of(intact, rows, [*((None, each) for each in left_out), *damage])
