"""Data set folders in stores of objects, by any address that fsspec knows (``s3://...``, ``memory://...``).

Objects appear whole; nothing is moved or locked, and no bucket is ever made.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import IO, TYPE_CHECKING, ClassVar, TypeVar

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.json_types import JsonDict, JsonObject
from tactile_toolkit.store.addresses import scheme_of
from tactile_toolkit.store.data_folder import DataFolder
from tactile_toolkit.store.files import named_failures, scratch_folder
from tactile_toolkit.store.remote import ask_store, client_of, has_buckets, open_in_store

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

T = TypeVar("T")

_UPLOAD_OPTIONS = {"s3": {"max_concurrency": 2}}


@dataclass(frozen=True)
class FsspecFolder(DataFolder):
    """A data set folder in a store of objects, by its address."""

    root: str
    is_local: ClassVar[bool] = False

    def __reduce__(self) -> tuple[object, ...]:
        return FsspecFolder, (self.root,)  # without open connections

    @cached_property
    def _client(self) -> AbstractFileSystem:
        return client_of(self.root)

    def _ask(self, action: Callable[[], T], doing: str, path: str, size_bytes: int = 0) -> T:
        return ask_store(action, doing, self.address(path), size_bytes)

    def _key(self, path: str = "") -> str:
        """Return the key of a file, as the client names it."""
        return str(self._client._strip_protocol(self.address(path))).rstrip("/")

    def problem(self) -> str:
        """Return why the folder cannot hold files, or ``""`` if it can."""
        bucket = self._key().partition("/")[0]
        if has_buckets(self.root) and self._info(bucket, "") is None:
            return f"the bucket {bucket!r} of {self.root!r} does not exist"
        return ""

    def info(self, path: str) -> JsonObject | None:
        """Return type and size of a file or folder, and values that change with it; None if there is none."""
        return self._info(self._key(path), path)

    def _info(self, key: str, path: str) -> JsonObject | None:
        with contextlib.suppress(FileNotFoundError):
            found: JsonObject = self._ask(lambda: self._client.info(key), "reading", path)
            return found
        return None

    def entries(self, folder: str = "") -> dict[str, int | None]:
        """List names directly in a sub-folder, sorted, with sizes in bytes, None for what is not a file."""
        key, sizes = self._key(folder), {}
        with contextlib.suppress(FileNotFoundError):
            found = self._ask(lambda: self._client.ls(key, detail=True), "listing", folder)
            for entry in found:
                name = entry["name"].strip("/")
                # A file, and the mark of an empty folder, are listed in themselves.
                if name != key.strip("/"):
                    is_folder = entry["type"] == "directory"
                    sizes[name.rpartition("/")[2]] = None if is_folder else int(entry["size"])
        return dict(sorted(sizes.items()))

    def walk(self, folder: str = "") -> Iterator[str]:
        """Yield the paths of all files in a sub-folder and below it, in order of their names."""
        for name, size in self.entries(folder).items():
            path = f"{folder}/{name}".lstrip("/")
            if size is None:
                yield from self.walk(path)
            else:
                yield path

    def open(self, path: str) -> IO[bytes]:
        """Open a file for reading piece by piece; a file that is replaced is not read on."""
        # Its `details` are those of the store.
        return open_in_store(self._client, self._key(path), self.address(path))

    def read_bytes(self, path: str) -> bytes:
        """Read a whole (small) file; IntegrityError when it is missing."""
        key = self._key(path)
        try:
            return bytes(self._ask(lambda: self._client.cat_file(key), "reading", path))
        except FileNotFoundError as error:
            raise IntegrityError(f"cannot read {self.address(path)!r}: {error.strerror or error}") from error

    def write_bytes(self, path: str, content: bytes) -> None:
        """Write a file in one request."""
        options = self._in_one_request(content)
        self._put(path, len(content), lambda key: self._client.pipe_file(key, content, **options))

    def create_bytes(self, path: str, content: bytes) -> None:
        """Write a file in one request unless there is one of that name, where the store can tell."""
        options = self._in_one_request(content) | {"mode": "create"}
        with contextlib.suppress(FileExistsError):
            self._put(path, len(content), lambda key: self._client.pipe_file(key, content, **options))

    def _in_one_request(self, content: bytes) -> JsonDict:
        """Return what keeps a killed writer from leaving pieces, which cost money and are not listed."""
        if scheme_of(self.root) == "s3":
            return {"chunksize": len(content) + 1}
        return {}

    def upload(self, path: str, source: Path) -> None:
        """Write a copy of a file of this machine in pieces."""
        options = _UPLOAD_OPTIONS.get(scheme_of(self.root), {})
        size_bytes = source.stat().st_size
        self._put(path, size_bytes, lambda key: self._client.put_file(str(source), key, **options))

    def write(self, path: str, fill: Callable[[IO[bytes]], T]) -> T:
        """Write a file in pieces, which are put together in ``$TMPDIR``; return what ``fill`` returns."""
        with scratch_folder() as scratch:
            file = scratch / "file"
            with named_failures(str(file)), file.open("wb") as stream:
                filled = fill(stream)
            self.upload(path, file)
        return filled

    def _put(self, path: str, size_bytes: int, put: Callable[[str], object]) -> None:
        self._require_writable(path)
        key = self._key(path)
        try:
            self._ask(lambda: put(key), "writing", path, size_bytes)
        except FileNotFoundError as error:
            if has_buckets(self.root):
                raise self._no_bucket() from error
            parent = key.rpartition("/")[0]
            self._ask(lambda: self._client.makedirs(parent, exist_ok=True), "writing", path)
            self._ask(lambda: put(key), "writing", path, size_bytes)

    def download(self, path: str, target: Path) -> None:
        """Copy a file to a local one; FileNotFoundError where there is none."""
        target.parent.mkdir(parents=True, exist_ok=True)
        key, size_bytes = self._key(path), self.size_bytes(path)
        self._ask(lambda: self._client.get_file(key, str(target)), "reading", path, size_bytes)

    def remove(self, path: str) -> None:
        """Remove a file, if it exists."""
        self._require_writable(path)
        with contextlib.suppress(FileNotFoundError):
            self._ask(lambda: self._client.rm_file(self._key(path)), "removing", path)

    def remove_empty(self, folder: str) -> None:
        """Do nothing: a sub-folder has gone with its last file."""
        self.address(folder)  # refuses a path that leads out of the folder

    def remove_temporaries(self) -> None:
        """Do nothing: an unfinished file is not in the store."""

    def require_folder(self) -> None:
        """Raise InputError if there is a file of that name, or if the bucket does not exist."""
        self._require_writable("")
        found = self.info("")
        if found is not None and found["type"] == "file":
            raise InputError(
                f"{self.root!r} is a file; expected a folder", next="choose another path (--out or OUT)"
            )
        if found is None and self.problem():
            raise self._no_bucket()

    def refresh(self, folder: str) -> None:
        """Do nothing: listings are never kept."""

    @contextlib.contextmanager
    def locked(
        self, *, shared: bool = False, patience_s: float | None = None, is_patient: bool = False
    ) -> Iterator[None]:
        """Hold nothing: stores have no locks."""
        yield

    def _no_bucket(self) -> InputError:
        return InputError(
            f"{self.problem()}; nothing was written, and no bucket was made",
            next="check its name, or make it with the store's own tools",
        )

    def _require_writable(self, path: str) -> None:
        if scheme_of(self.root) == "hf":
            raise InputError(
                f"{self.address(path)!r} cannot be written to: the Hub takes whole commits",
                next="write to a folder or to s3://BUCKET/FOLDER, then send it with the command `upload`",
            )
