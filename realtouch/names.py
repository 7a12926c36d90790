"""What names of data sets of touches mean: short names, repositories, folders, files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from os import PathLike, fsdecode
from typing import Any

from realtouch.kind import KIND
from tactile_toolkit.catalog.kinds import place_of as place_of_name
from tactile_toolkit.catalog.locate import find_files, find_shards
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
    if not isinstance(name, (str, PathLike)):
        return tuple(_file_names(name))
    place = place_of_name(fsdecode(name))
    try:
        return str(expanded(place)) if place.startswith("~") else place
    except InputError:  # an unknown user's home; refused where it is opened
        return place


def open_shards(
    name: Name | Sequence[Name], split: str | None, *, revision: str | None = None, streaming: bool = False
) -> tuple[Shard, ...]:
    """Find the shards of one split of whatever :func:`realtouch.load` understands; InputError without any."""
    if isinstance(name, (str, PathLike)):
        place = place_of_name(fsdecode(name))
        return find_shards(place, split, revision=revision, streaming=streaming)
    return find_files(_file_names(name), revision=revision, streaming=streaming)


def _file_names(names: Any) -> list[str]:
    """Return names of files as text; whatever else was given for a name of a data set is refused here."""
    is_list = isinstance(names, Iterable) and not isinstance(names, (bytes, bytearray))
    files = list(names) if is_list else [names]
    for file in files:
        if not isinstance(file, (str, PathLike)):
            raise InputError(
                f"{file!r} ({type(file).__name__}) is not a name of a data set; expected a short name "
                "such as 'real-single-64x64', USER/NAME on the Hub, a folder, a Parquet file, or several of "
                "these files"
            )
    return [fsdecode(file) for file in files]
