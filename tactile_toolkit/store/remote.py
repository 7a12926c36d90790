"""Folders in object stores, through fsspec: what other processes write is seen, what goes wrong is named.

Nothing is remembered of what a store said: listings of fsspec's clients are kept for good otherwise, and
another process may write there at any moment. Objects appear whole. No bucket is ever made.
"""

from __future__ import annotations

import contextlib
import io
import logging
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import IO, Any, TypeVar, cast

from tactile_toolkit.errors import InputError
from tactile_toolkit.store.address import scheme_of
from tactile_toolkit.store.store_failures import failure_of, is_passing, not_installed, shown_cause

__all__ = ["VERSION_KEYS", "StoreFiles"]

VERSION_KEYS = ("size", "ETag", "etag", "blob_id", "mtime", "created")
"""What stores say of a file, under which name each, that changes with its content."""

_READ_AHEAD_BYTES = 1 << 20
_PATIENCE_S = 30.0
"""For so long what fails in passing is tried again, once the store has answered."""
_FIRST_PATIENCE_S = 10.0
"""The same before it has: an address that was mistyped never answers."""
_LIMITS = {"connect_timeout": 5, "read_timeout": 20, "retries": {"total_max_attempts": 1}}
"""Of the client of S3, which would try five times what is tried again here, within one time limit."""
_PACKAGES = {"s3": "s3fs", "gs": "gcsfs", "abfs": "adlfs", "az": "adlfs"}
"""Of stores with buckets, the client of each."""

T = TypeVar("T")


@dataclass(frozen=True)
class StoreFiles:
    """A folder at an address such as ``s3://BUCKET/FOLDER``, in the form of ``address.place_of_data``.

    Paths are relative to it. Every method raises RemoteError when the store cannot be reached or refuses, and
    InputError when its package is not installed.
    """

    address: str
    _met: list[bool] = field(default_factory=list, init=False, repr=False, compare=False)

    @cached_property
    def _system(self) -> Any:
        """The client, shared in this process by all folders of the same kind of store."""
        import fsspec

        scheme = scheme_of(self.address)
        try:
            system = fsspec.filesystem(scheme, **_options(scheme))
        except ImportError as error:
            raise not_installed(self.address, scheme, _PACKAGES.get(scheme), error) from error
        except ValueError as error:
            message = (
                f"{self.address!r}: no store is known by {scheme + '://'!r}; next: give a folder, "
                "s3://BUCKET/FOLDER or gs://BUCKET/FOLDER"
            )
            raise InputError(message) from error
        if scheme == "s3":
            system.retries = 1  # see _LIMITS
        # What goes wrong is told here; where nobody listens to its log, gcsfs prints it with tracebacks.
        logging.getLogger(type(system).__module__.partition(".")[0]).addHandler(logging.NullHandler())
        return system

    @cached_property
    def _root(self) -> str:
        return str(self._system._strip_protocol(self.address)).rstrip("/")

    def _key(self, path: str) -> str:
        return f"{self._root}/{path}" if path else self._root

    def info(self, path: str = "") -> Mapping[str, Any] | None:
        """Return what the store says of a file or folder; None when there is no such."""

        def ask() -> Mapping[str, Any]:
            found: Mapping[str, Any] = self._system.info(self._key(path))
            return found

        try:
            return self._asked(ask, "reading", path)
        except FileNotFoundError:
            return None

    def exists(self, path: str = "") -> bool:
        """Return whether there is such a file or folder."""
        return self.info(path) is not None

    def version(self, path: str) -> tuple[object, ...] | None:
        """Return what changes whenever a file is replaced; None where there is none."""
        found = self.info(path)
        return (
            None if found is None else tuple(str(found.get(key)) for key in (*VERSION_KEYS, "LastModified"))
        )

    def entries(self, folder: str = "") -> dict[str, int | None]:
        """List names directly in a sub-folder, sorted, with sizes in bytes, None for folders."""
        key = self._key(folder)
        try:
            found = self._asked(lambda: self._system.ls(key, detail=True), "listing", folder)
        except FileNotFoundError:
            return {}
        # Stores list a file, and the mark of an empty folder, as if it held itself.
        inside = [entry for entry in found if entry["name"].strip("/") != key.strip("/")]
        sizes = {
            entry["name"].rstrip("/").rpartition("/")[2]: (
                None if entry["type"] == "directory" else int(entry["size"])
            )
            for entry in inside
        }
        return dict(sorted(sizes.items()))

    def open(self, path: str) -> IO[bytes]:
        """Open a file for reading piece by piece; its ``details`` are what the store says of it.

        Raises FileNotFoundError. A file that is replaced meanwhile is not read on.
        """
        key = self._key(path)
        stream = self._asked(
            lambda: self._system.open(key, "rb", block_size=_READ_AHEAD_BYTES), "reading", path
        )
        if scheme_of(self.address) == "hf":
            opened: IO[bytes] = stream  # whoever reads from the Hub names its failures
            return opened
        return cast(IO[bytes], _Stream(self, path, stream))

    def read(self, path: str) -> bytes:
        """Read a whole file at once; raises FileNotFoundError."""
        return bytes(self._asked(lambda: self._system.cat_file(self._key(path)), "reading", path))

    def put(self, path: str, content: bytes | Path) -> None:
        """Write a whole file in place of any other, or copy a local one in pieces, two held at a time."""
        key = self._key(path)
        if isinstance(content, bytes):
            self._put(path, content, lambda options: self._system.pipe_file(key, content, **options))
            return
        options = {"max_concurrency": 2} if scheme_of(self.address) == "s3" else {}
        self._require_writable(path)
        try:
            self._asked(lambda: self._system.put_file(str(content), key, **options), "writing", path)
        except FileNotFoundError as error:
            raise self._no_bucket() from error

    def create(self, path: str, content: bytes) -> bool:
        """Write a whole file unless there is one; return whether this call did.

        Of several writers at once one wins, where the store knows conditional writes (S3 and gs do).
        """
        tries = 0

        def put(options: dict[str, Any]) -> None:
            nonlocal tries
            tries += 1
            self._system.pipe_file(self._key(path), content, mode="create", **options)

        try:
            self._put(path, content, put)
        except FileExistsError:
            # The answer to an earlier try may have been lost after the store had done it.
            return tries > 1 and self.read(path) == content
        return True

    def move(self, path: str, target: str) -> None:
        """Refuse, for nothing is moved in a store."""
        raise NotImplementedError(path, target)

    def download(self, path: str, target: Path) -> None:
        """Copy a file of the store to a local one, whose folder must be there; raises FileNotFoundError."""
        self._asked(lambda: self._system.get_file(self._key(path), str(target)), "reading", path)

    def remove(self, path: str) -> None:
        """Remove a file, if it is there."""
        self._require_writable(path)
        with contextlib.suppress(FileNotFoundError):
            self._asked(lambda: self._system.rm_file(self._key(path)), "removing", path)

    def remove_empty(self, folder: str) -> None:
        """Do nothing: a sub-folder has gone with its last file."""

    @contextlib.contextmanager
    def lock(self, *, shared: bool, patience_s: float) -> Iterator[None]:
        """Do nothing: stores have no locks."""
        yield

    def refresh(self, folder: str) -> None:
        """Do nothing: what a store says is never remembered."""

    def make(self) -> None:
        """Make sure that there is a bucket and no file in the folder's place; raises InputError."""
        self._require_writable("")
        found = self.info()
        if found is not None and found["type"] == "file":
            message = f"{self.address!r} is a file, a folder was expected; choose another path (--out or OUT)"
            raise InputError(message)
        if found is None and not self.has_bucket():
            raise self._no_bucket()

    def has_bucket(self) -> bool:
        """Tell whether the bucket is there, as far as these credentials may know."""
        if not _knows_buckets(scheme_of(self.address)):
            return True
        bucket = self._root.partition("/")[0]
        try:
            self._asked(lambda: self._system.info(bucket), "looking for", "")
        except FileNotFoundError:
            return False
        return True

    def _no_bucket(self) -> InputError:
        bucket = self._root.partition("/")[0]
        message = (
            f"the bucket {bucket!r} of {self.address!r} does not exist; nothing was written, and no bucket "
            "was made; next: check its name, or make it with the store's own tools"
        )
        return InputError(message)

    def _require_writable(self, path: str) -> None:
        if scheme_of(self.address) == "hf":
            message = (
                f"{_inside(self.address, path)!r} cannot be written to: the Hub takes whole commits; next: "
                "write to a folder or to s3://BUCKET/FOLDER, then send it with the command `upload`"
            )
            raise InputError(message)

    def _put(self, path: str, content: bytes, put: Callable[[dict[str, Any]], object]) -> None:
        self._require_writable(path)
        scheme = scheme_of(self.address)
        # In one request, so that a writer that is killed leaves no pieces that cost money and nobody sees.
        options = {"chunksize": len(content) + 1} if scheme == "s3" else {}
        try:
            self._asked(lambda: put(options), "writing", path)
        except FileNotFoundError as error:
            if _knows_buckets(scheme):
                raise self._no_bucket() from error
            self._asked(lambda: self._make_folder_of(path), "writing", path)
            self._asked(lambda: put(options), "writing", path)

    def _make_folder_of(self, path: str) -> None:
        """Make the folder of a file in stores that have folders, which are not those with buckets."""
        self._system.makedirs(self._key(path).rpartition("/")[0], exist_ok=True)

    def _asked(self, action: Callable[[], T], doing: str, path: str) -> T:
        """Do something with the store; what fails in passing is tried again for a while."""
        began_s, wait_s = time.monotonic(), 0.5
        while True:
            try:
                done = action()
            except (FileNotFoundError, FileExistsError):
                self._met.append(True)
                raise
            except Exception as error:
                failure = failure_of(error, doing, _inside(self.address, path))
                if failure is None:
                    raise
                waited_s = time.monotonic() - began_s + wait_s
                patience_s = _PATIENCE_S if self._met else _FIRST_PATIENCE_S
                if not is_passing(error) or waited_s > patience_s:
                    raise failure from shown_cause(error)
                time.sleep(wait_s)
                wait_s *= 2
            else:
                if not self._met:
                    self._met.append(True)
                return done


class _Stream(io.BufferedIOBase):
    """A file of a store, read piece by piece."""

    def __init__(self, folder: StoreFiles, path: str, stream: Any) -> None:
        super().__init__()
        self._folder, self._path, self._stream = folder, path, stream
        self.details: Mapping[str, Any] | None = getattr(stream, "details", None)

    def read(self, size: int | None = -1) -> bytes:
        position = self._stream.tell()

        def ask() -> bytes:
            self._stream.seek(position)
            return bytes(self._stream.read(-1 if size is None else size))

        return self._folder._asked(ask, "reading", self._path)

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        return int(self._stream.seek(offset, whence))

    def tell(self) -> int:
        return int(self._stream.tell())

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def close(self) -> None:
        self._stream.close()
        super().close()


def _inside(address: str, path: str) -> str:
    return f"{address}/{path}" if path else address


def _knows_buckets(scheme: str) -> bool:
    return scheme in _PACKAGES


def _options(scheme: str) -> dict[str, Any]:
    """Return what the client of a store is made with."""
    if scheme == "hf":
        return {}  # a commit never changes, and others are looked up by name
    if scheme != "s3":
        return {"use_listings_cache": False}
    from fsspec.config import conf

    # What the user sets in fsspec's own configuration holds; given here, it would be passed over.
    own = conf.get("s3", {}).get("config_kwargs", {})
    return {"use_listings_cache": False, "config_kwargs": {**_LIMITS, **own}}
