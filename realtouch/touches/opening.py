"""Opening data sets of real touches, by names: short names, repositories, folders, files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal, overload

from realtouch import kind
from realtouch.touches import damage, datasets, schema
from tactile_toolkit import errors, places, read

_NAMES_SHOWN = 12

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
        A short name (see :data:`realtouch.touches.opening.SHORT_NAMES`), any repository of the Hub
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
    files = agreeing_files(place.shards(split, kind=kind.KIND, streaming=streaming), place.name)
    if streaming:
        return datasets.TouchStream(tuple(files), schema.media_kind(files[0].schema, files[0].path))
    return datasets.dataset_of(files)


def agreeing_files(
    shards: Iterable[read.Shard], where: str, left_out: list[damage.Damage] | None = None
) -> list[read.Shard]:
    """Return the files of a data set that can be read and agree with the first of them.

    The damage of the other files is added to ``left_out``. Without such a list it is raised: InputError for a
    file without touches, IntegrityError for a file that is damaged or differs.
    """
    files: list[read.Shard] = []
    for shard in shards:
        try:
            if not files:
                schema.media_kind(shard.schema, where)
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
        found, wanted = (", ".join(each[:_NAMES_SHOWN]) for each in (names, expected))
        raise errors.IntegrityError(
            f"{shard.path!r}, field 'label': the classes are named {found}; expected {wanted} as in the "
            "files before it",
            next="open them apart, or make them again",
        )
