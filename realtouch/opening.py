"""Opening data sets of real touches, by names: short names, repositories, folders, files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, overload

from realtouch import integrity, kind, schema, touch_dataset
from tactile_toolkit import places

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
) -> touch_dataset.TouchSeqDataset | touch_dataset.TouchSingleDataset: ...
@overload
def load(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    *,
    streaming: Literal[True],
    revision: str | None = None,
    config: str | None = None,
) -> touch_dataset.TouchStream: ...
@overload
def load(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    streaming: bool = False,
    revision: str | None = None,
    *,
    config: str | None = None,
) -> touch_dataset.TouchSeqDataset | touch_dataset.TouchSingleDataset | touch_dataset.TouchStream: ...
def load(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    streaming: bool = False,
    revision: str | None = None,
    *,
    config: str | None = None,
) -> touch_dataset.TouchSeqDataset | touch_dataset.TouchSingleDataset | touch_dataset.TouchStream:
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
    place = places.open_place(name, revision=revision, config=config)
    files = integrity.agreeing_files(place.shards(split, kind=kind.KIND, streaming=streaming), place.name)
    if streaming:
        return touch_dataset.TouchStream(tuple(files), schema.media_kind(files[0].schema, files[0].path))
    return touch_dataset.dataset_of(files)
