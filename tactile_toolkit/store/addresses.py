"""Folders and files as users name them: local paths, addresses of stores, outputs that replace nothing."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from operator import methodcaller
from pathlib import Path

from tactile_toolkit import errors, wording
from tactile_toolkit.run.this_process import working_folder
from tactile_toolkit.store.files import draft_of, expanded, is_hidden, named_failures, write_file
from tactile_toolkit.store.folder import DataFolder, LocalFolder
from tactile_toolkit.store.remote import FsspecFolder

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")
_LOST_SLASH = re.compile(r"(?:s3a?|gs|gcs|hf|abfs|az):/(?!/)")
_OTHER_NAMES = {"s3a": "s3", "gcs": "gs", "file": "", "local": ""}
_WEB_SCHEMES = ("http", "https")
_OTHER_OUT = "choose another --out"


def scheme_of(address: str) -> str:
    """Return the scheme of an address, such as ``s3``; empty for a local path or a ``file://`` address."""
    match = _SCHEME.match(address)
    scheme = match[1].lower() if match else ""
    return _OTHER_NAMES.get(scheme, scheme)


def normalize_uri(address: str) -> str:
    """Return a local path without ``file://``, or an address in canonical form, without a trailing slash.

    Raises InputError for an address that names no bucket, is of the web, or may hold a key or a signature.
    """
    if ":" not in address:  # a path, as most are
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


def list_files(folder: Path, endings: Collection[str] = ()) -> list[Path]:
    """List the visible files directly in a folder of the user's, in natural order; sub-folders are left out.

    ``endings`` are those of the files to list, in lower case; all by default. Raises InputError for a link
    out of the folder, whose target may be private, for a link to nothing, and for a pipe or a device.
    """
    home = open_folder(str(folder))
    paths = [folder / name for name in home.names() if not is_hidden(name)]
    files = [path for path in paths if not path.is_dir() and (not endings or path.suffix.lower() in endings)]
    for path in files:
        problem = home.problem_of_file(path.name)
        if problem:
            raise errors.InputError(f"{str(path)!r} {problem}")
    return sorted(files, key=lambda path: (wording.natural_key(path.name.casefold()), path.name))


@dataclass(frozen=True)
class Output:
    """The files that a command writes into a local folder; see :func:`open_output`."""

    folder: LocalFolder
    names: tuple[str, ...]
    overwrite: bool
    is_alone: bool
    next: str

    def require_free(self) -> None:
        """Raise InputError if a file is in the way."""
        for name in self.names:
            path = self.folder.local_path(name)
            if path.exists() and (path.is_dir() or not self.overwrite):
                problem = "is a folder" if path.is_dir() else "exists"
                raise errors.InputError(
                    f"{str(path)!r} {problem}; nothing was written",
                    next=_OTHER_OUT if path.is_dir() else self.next,
                )
        others = [name for name in self.folder.names() if name not in self.names and not is_hidden(name)]
        if self.is_alone and others:
            raise errors.InputError(
                f"{self.folder.root!r} holds {others[0]!r}, which this command does not write; nothing was "
                "written",
                next=_OTHER_OUT,
            )

    def write(
        self, contents: Mapping[str, bytes], check: Callable[[Path], object] = lambda _folder: None
    ) -> None:
        """Write files by name; they get their names, in order, when all are complete and checked.

        ``check`` takes the temporary folder with the files. Raises what it raises, InputError if a file came
        in the way meanwhile, and StorageError if they cannot be written; then nothing was replaced.
        """
        self.folder.require_folder()
        stage = draft_of(Path(self.folder.root, "output"))
        with named_failures(self.folder.root):
            try:
                for name, content in contents.items():
                    write_file(stage / name, methodcaller("write", content))
                check(stage)
                self.require_free()
                for name in contents:
                    (stage / name).replace(self.folder.local_path(name))
            finally:
                shutil.rmtree(stage, ignore_errors=True)


def open_output(
    path: str | Path,
    names: Sequence[str] = (),
    *,
    overwrite: bool = False,
    is_alone: bool = False,
    next: str = f"add --overwrite, or {_OTHER_OUT}",
) -> Output:
    """Open the output of a command before its work, so that nothing is refused afterwards.

    Parameters
    ----------
    path : str or Path
        A local file, or with ``names`` a folder; folders are made when files are written.
    names : sequence of str
        Files of the folder that the command writes.
    overwrite : bool
        Replace existing files of these names; a folder of such a name is never replaced.
    is_alone : bool
        Refuse a folder with other visible files.
    next : str
        Next step if one of the files exists.

    Raises
    ------
    InputError
        Something is in the way, or the path is not a local one.
    StorageError
        The folder cannot be written to.
    """
    target = expanded(path)
    home = local_folder_path(str(path if names else target.parent))
    output = Output(LocalFolder(str(home)), tuple(names) or (target.name,), overwrite, is_alone, next)
    output.require_free()
    # A run that is refused leaves no empty folder, so a new one is made by `write`.
    nearest = home
    while not nearest.exists():
        nearest = nearest.parent
    LocalFolder(str(nearest)).require_folder()
    return output
