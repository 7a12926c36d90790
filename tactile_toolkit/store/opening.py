"""Opening data set folders by their address."""

from __future__ import annotations

from pathlib import Path

from tactile_toolkit.errors import InputError
from tactile_toolkit.store.addresses import is_remote, normalize_uri
from tactile_toolkit.store.data_folder import DataFolder
from tactile_toolkit.store.files import expanded
from tactile_toolkit.store.fsspec_folder import FsspecFolder
from tactile_toolkit.store.local_folder import LocalFolder
from tactile_toolkit.system import working_folder


def open_folder(address: str) -> DataFolder:
    """Return the data set folder at a path or any fsspec address; it need not exist.

    Raises InputError for a web address, and for one that names no bucket or may hold a key.
    """
    place = normalize_uri(address)
    if is_remote(address):
        return FsspecFolder(place)
    path = expanded(place)
    if not path.is_absolute():  # only then is the working folder needed, which may have been deleted
        path = working_folder() / path
    return LocalFolder(str(path))


def split_uri(address: str) -> tuple[DataFolder, str]:
    """Return the folder of a file, local or at an address, and its name in it."""
    if is_remote(address):
        parent, _, name = normalize_uri(address).rpartition("/")
        return open_folder(parent), name
    path = Path(normalize_uri(address))
    return open_folder(str(path.parent)), path.name


def local_folder_path(address: str) -> Path:
    """Return the path of a folder, which need not exist; InputError if it is a file or not local."""
    folder = open_folder(address)
    path = Path(folder.root)
    if folder.is_local and not path.is_file():
        return path
    found = "is not a local folder"
    if folder.is_local:
        found = "is a file; expected a folder"
    raise InputError(f"{address!r} {found}; nothing was changed", next="give a local folder as --out")
