"""Names of data sets: one function resolves them, on this machine, in a store or on the Hub."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias, cast

from tactile_toolkit import hub, store
from tactile_toolkit.errors import InputError
from tactile_toolkit.places.hub_place import hub_place
from tactile_toolkit.places.other_files import is_interrupted, is_parquet_file, not_a_set
from tactile_toolkit.places.place import Place, shards_by_split
from tactile_toolkit.places.published import published_set
from tactile_toolkit.places.split_files import (
    CARD_FILE,
    PARQUET,
    USUAL_SPLIT,
    has_shards,
    require_some,
    split_of_file,
    splits_by_card,
    splits_by_name,
)

# Depth of folders in which files are searched, and their largest number.
_DEPTH = 4
_MAX_FOLDERS = 1000

Name: TypeAlias = "str | os.PathLike[str]"
"""A folder, a Parquet file, a repository of the Hub or the short name of a published set."""


def open_place(
    name: Name | Place | Sequence[Name],
    *,
    revision: str | None = None,
    config: str | None = None,
    allow_incomplete: bool = False,
) -> Place:
    """Resolve the name of a data set; reads no row.

    Parameters
    ----------
    name : str, path, Place, or sequence of them
        A folder or a Parquet file, local or in an object store (``s3://BUCKET/FOLDER``); a repository of the
        Hub, ``USER/NAME[@REVISION]``, or a folder or file in it, ``hf://datasets/USER/NAME[@REVISION]/PATH``;
        the short name of a published set; or several files that belong together. Local data comes first.
    revision : str, optional
        Branch, tag or commit of a repository.
    config : str, optional
        Configuration, of a data set whose card has several.
    allow_incomplete : bool
        Take the finished shards of a data set whose run is not finished.

    Raises
    ------
    InputError
        Nothing of that name, or no data set; several configurations, or two folders with files of one split.
    IntegrityError
        The manifest is damaged.
    HubError
        The repository cannot be reached or does not exist.
    """
    if isinstance(name, Place):
        return name
    found = _several(name, revision)
    if found is None:
        text = os.fsdecode(cast(Name, name))
        local = _local(_without_short_name(text))
        found = _local_place(text, *local, config) if local else hub_place(text, revision, config)
        if local and revision is not None:
            raise InputError(
                f"{text!r} is not on the Hub and has no revisions; {revision!r} was asked for",
                next="leave it out, or name a repository",
            )
    return replace(found.require_config(config), allow_incomplete=allow_incomplete)


def folder_place(folder: store.DataFolder) -> Place:
    """Return the place of a data set folder."""
    return _local_place(folder.address(), folder, "", None)


def _several(names: object, revision: str | None) -> Place | None:
    """Return the place of several files that belong together, each of any split; None for a single name."""
    if isinstance(names, (str, os.PathLike)):
        return None
    files = [names]
    if isinstance(names, Iterable) and not isinstance(names, (bytes, bytearray)):
        files = list(names)
    if not files:
        raise InputError("no files given; expected Parquet files of one data set")
    opened: dict[tuple[str, str | None], hub.HubRepository] = {}
    places = []
    for file in [_require_name(file) for file in files]:
        place = open_place(file, revision=revision)
        if not place.is_file:
            raise InputError(f"{place.name!r} is not a file; expected Parquet files of one data set")
        if place.repository is not None:  # all files of one commit
            key = place.repository.repo_id, place.repository.revision
            place = replace(place, source=opened.setdefault(key, place.repository))
        places.append(place)
    name = ", ".join(place.name for place in places)
    return Place(name, tuple(places), {USUAL_SPLIT: ("",)}, is_file=True)


def _require_name(name: object) -> Name:
    if isinstance(name, (str, os.PathLike)):
        return name
    raise InputError(
        f"{name!r} ({type(name).__name__}) is not a name of a data set; expected a short name such as "
        "'real-single-64x64', USER/NAME on the Hub, a folder, a Parquet file, or several of these files"
    )


def _without_short_name(name: str) -> str:
    """Return a name, or nothing if it is the short name of a published set and there is no such data."""
    # Short names have no slash: most names are paths, and need no list of kinds.
    if "/" in name or published_set(name) is None:
        return name
    # The folder must hold data: a checkout of the toolkit has a folder called ``mnist3d``, too.
    place, patterns = Path(name), (store.MANIFEST_FILE, "*.parquet", f"{store.DATA_FOLDER}/*.parquet")
    is_data = place.is_file() or any(next(place.glob(pattern), None) for pattern in patterns)
    if is_data:
        return name
    return ""


def _local(name: str) -> tuple[store.DataFolder, str] | None:
    """Return a folder, or the folder of a file and its name, local or in an object store; None otherwise.

    Raises InputError for a missing folder of a store, which can be nothing else.
    """
    if not name or store.scheme_of(name) == "hf":
        return None
    try:
        path = store.local_path(name)
    except InputError:  # an unknown user's home
        return None
    if path is None:
        if name.endswith(PARQUET):
            return store.split_uri(name)
        folder = store.open_folder(name)
        if not folder.exists():
            raise InputError(
                f"{folder.missing_message('data set')}; expected the folder of a data set, or a Parquet file",
                next="check the address",
            )
        return folder, ""
    with store.readable(name):
        if not store.path_exists(path):
            return None
    if path.is_dir():
        return store.open_folder(str(path)), ""
    if path.is_file():
        return store.open_folder(str(path.parent)), path.name
    return None


def _local_place(name: str, folder: store.DataFolder, file: str, config: str | None) -> Place:
    """Return the place of a file of a folder, or of the folder."""
    if file:
        if folder.is_local and not is_parquet_file(folder, file):
            raise not_a_set(folder, name, file)
        return Place(name, folder, {split_of_file(file) or USUAL_SPLIT: (file,)}, is_file=True)
    store.resume_promotion(folder)  # a folder that is being replaced has files of two data sets
    manifest = store.manifest_so_far(folder)
    if manifest is not None:
        return Place(name, folder, shards_by_split(manifest), manifest, manifest.complete)
    if is_interrupted(folder):
        raise not_a_set(folder, name)
    if folder.exists(CARD_FILE):
        named = splits_by_card(folder.read_bytes(CARD_FILE), _walked(folder), config, name)
        if named is not None:
            return Place(name, folder, require_some(named, name), config=config)
    in_data = [f"{store.DATA_FOLDER}/{each}" for each in folder.names(store.DATA_FOLDER)]
    if not has_shards(in_data):
        in_data = _walked(folder)
    found = splits_by_name(in_data, name)
    if not found:
        raise not_a_set(folder, name)
    return Place(name, folder, found)


def _walked(folder: store.DataFolder) -> list[str]:
    """List the files in a folder and some levels below; InputError if there are too many folders."""
    files: list[str] = []
    waiting = [("", 0)]
    for count, (inside, depth) in enumerate(waiting):
        if count > _MAX_FOLDERS:
            raise InputError(
                f"{folder.address()!r} holds more than {_MAX_FOLDERS:,} folders; expected a data set",
                next="give the folder of one data set",
            )
        entries = folder.entries(inside)
        if inside and store.MANIFEST_FILE in entries:
            continue  # a data set of its own
        for name, size in entries.items():
            path = f"{inside}/{name}".lstrip("/")
            if size is not None:
                files.append(path)
            elif depth < _DEPTH and not store.is_hidden(name):
                waiting.append((path, depth + 1))
    return files
