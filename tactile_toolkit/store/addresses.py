"""Folders as users name them: local paths, and addresses of stores."""

from __future__ import annotations

import re
from pathlib import Path

from tactile_toolkit import errors
from tactile_toolkit.run.this_process import working_folder
from tactile_toolkit.store.files import expanded
from tactile_toolkit.store.folder import DataFolder, LocalFolder
from tactile_toolkit.store.remote import FsspecFolder

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")
_LOST_SLASH = re.compile(r"(?:s3a?|gs|gcs|hf|abfs|az):/(?!/)")
_OTHER_NAMES = {"s3a": "s3", "gcs": "gs", "file": "", "local": ""}
_WEB_SCHEMES = ("http", "https")


def scheme_of(address: str) -> str:
    """Return the scheme of an address, such as ``s3``; empty for a local path or a ``file://`` address."""
    match = _SCHEME.match(address)
    scheme = match[1].lower() if match else ""
    return _OTHER_NAMES.get(scheme, scheme)


def normalize_uri(address: str) -> str:
    """Return a local path without ``file://``, or an address in canonical form, without a trailing slash.

    Raises InputError for an address that names no bucket, is of the web, or may hold a key or a signature.
    """
    if ":/" not in address:  # a path, as most are
        return address
    errors.require_public(address)
    match = _SCHEME.match(address)
    if match is None and not _LOST_SLASH.match(address):
        return address
    scheme = scheme_of(address)
    location = address.partition("://")[2]
    if match and not scheme and location.startswith("/"):
        return location.rstrip("/") or "/"
    location = location.rstrip("/")
    bucket, *parts = location.split("/")
    is_plain = location.isprintable() and not {".", ".."} & {bucket, *parts}
    if not scheme or not bucket or scheme in _WEB_SCHEMES or not is_plain:
        raise errors.InputError(
            f"{address!r} is not the address of a data set; expected a folder, file:///FOLDER, "
            "s3://BUCKET/FOLDER or the like, of names without '.', '..' and control characters, "
            "and not of the web",
            next="write it so, as text (pathlib.Path drops a slash; a local folder of that name is ./NAME)",
        )
    return f"{scheme}://{location}"


def local_path(name: str) -> Path | None:
    """Return the local path that a user named, with ``~`` expanded; None for an address of a store."""
    return None if scheme_of(name) else expanded(normalize_uri(name))


def open_folder(address: str) -> DataFolder:
    """Return the data set folder at a path or any fsspec address; it need not exist.

    Raises InputError for a web address, and for one that names no bucket or may hold a key.
    """
    path = local_path(address)
    if path is None:
        return FsspecFolder(normalize_uri(address))
    if not path.is_absolute():  # only then is the working folder needed, which may have been deleted
        path = working_folder() / path
    return LocalFolder(str(path))


def split_uri(address: str) -> tuple[DataFolder, str]:
    """Return the folder of a file, local or at an address, and its name in it."""
    normalized = normalize_uri(address)
    if scheme_of(address):
        parent, _, name = normalized.rpartition("/")
        return open_folder(parent), name
    path = Path(normalized)
    return open_folder(str(path.parent)), path.name


def local_folder_path(address: str) -> Path:
    """Return the path of a folder, which need not exist; InputError if it is a file or not local."""
    folder = open_folder(address)
    path = Path(folder.root)
    if folder.is_local and not path.is_file():
        return path
    problem = "is a file; expected a folder" if folder.is_local else "is not a local folder"
    raise errors.InputError(
        f"{address!r} {problem}; nothing was changed", next="give a local folder as --out"
    )
