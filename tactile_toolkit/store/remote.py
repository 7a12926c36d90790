"""Data set folders in stores of objects, and calls of servers: retries, and one sentence for each failure.

Objects appear whole; nothing is moved or locked, and no bucket is ever made.

A failure becomes one error that states the next step, without keys and signatures, which clients may quote.
The clients' own exceptions are recognised by name, so none of their packages has to be installed; several
clients wrap the cause in a builtin exception without naming it.
"""

from __future__ import annotations

import contextlib
import io
import logging
import re
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, wait
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from threading import Thread
from typing import IO, TYPE_CHECKING, ClassVar, TypeVar, cast

from tactile_toolkit.errors import (
    InputError,
    IntegrityError,
    MissingExtraError,
    RemoteError,
    ToolkitError,
    redact,
)
from tactile_toolkit.store.files import named_failures, scratch_folder
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.value_types import JsonDict, JsonObject, JsonValue

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

ASKED_WAIT_S = 120.0
"""Longest total time to wait because a server asks for it, seconds."""

ANSWER_S = 60.0
"""Time that every answer may take, seconds; a server that sends a byte now and then would never end."""
MIN_BYTES_PER_S = 10_000
"""Speed that adds time for the size of an answer, bytes per second; slower transfers are given up."""

_READ_AHEAD = 1 << 20  # bytes
_UPLOAD_OPTIONS = {"s3": {"max_concurrency": 2}}
_WAITS_S = (0.5, 1.0, 2.0, 4.0, 8.0)
# No request is repeated after this time, which allows two requests without an answer.
_PATIENCE_S = 45.0
# Limits of the S3 client, without retries: they are made here, within one time limit.
_LIMITS = {"connect_timeout": 5, "read_timeout": 20, "retries": {"total_max_attempts": 1}}
# The client of each kind of store with buckets.
_PACKAGES = {"s3": "s3fs", "gs": "gcsfs", "abfs": "adlfs", "az": "adlfs"}

_CLIENTS = {"botocore", "aiobotocore", "aiohttp", "gcsfs", "google", "huggingface_hub", "httpx", "httpcore"}
_CLIENTS |= {"requests", "urllib3", "s3fs", "azure", "adlfs", "fsspec", "httpx2", "httpcore2"}
# Names of failures in stores and their clients; numbers are HTTP status codes.
_TRANSIENT = re.compile(
    "SlowDown|InternalError|Unavailable|RequestTimeout|Aborted|Throttling|Conflict|LimitExceeded|408|429|5.."
)
_CONNECTION = re.compile("Connect|Timeout|Incomplete|Payload|Streaming|HTTPClientError|ClientOSError")
_NO_ANSWER = "NoAnswer"
# The first matching pattern gives the message; it is searched in the status and the names of the exceptions.
_SENTENCES: tuple[tuple[str, type[ToolkitError], str, str], ...] = (
    ("FileExpired", IntegrityError, "{address!r} was replaced while it was read", "run it again"),
    (
        "InvalidBucketName|NoSuchBucketName|ParamValidation",
        InputError,
        "{address!r} holds no name that a bucket or file can have",
        "check it",
    ),
    (
        # S3 answers 400 to a HEAD request; a client in an endless redirection raises a RecursionError.
        "Redirect|AuthorizationHeader|LocationConstraint|RecursionError|301|307|400",
        RemoteError,
        "{address!r} lies in another region ({code}), or the credentials have expired",
        "set AWS_DEFAULT_REGION to the region of the bucket, check AWS_ENDPOINT_URL if you set it, and renew "
        "the credentials",
    ),
    (
        "Credential|Profile|Token|Expired|Auth|Access|Signature|Denied|Permission|Skewed|40[13]|Refresh",
        RemoteError,
        "{doing} {address!r} is refused ({code}: {answer})",
        "give credentials that may do that and have not expired, as the store's own tools take them (for S3: "
        "AWS_PROFILE, AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or `aws configure`), and check the clock "
        "of this machine",
    ),
    (
        _NO_ANSWER,
        RemoteError,
        "the store of {address!r} gives no answer ({answer}); finished files stay",
        "check the network and the address of the store (for S3: AWS_ENDPOINT_URL), and run the same command "
        "again",
    ),
    ("", RemoteError, "{doing} {address!r} failed: {code}: {answer}; finished files stay", "run it again"),
)

T = TypeVar("T")


@dataclass(frozen=True)
class CallFailure:
    """The error for an exception of a client, and whether the same call may succeed soon.

    ``asked_wait_s`` is the time that the server asks to wait, seconds.
    """

    error: ToolkitError
    is_transient: bool
    asked_wait_s: float = 0.0


def with_retry(
    action: Callable[[], T],
    failure_of: Callable[[Exception], CallFailure | None],
    waits_s: Sequence[float],
    *,
    patience_s: float = float("inf"),
    on_wait: Callable[[str], None] = lambda _: None,
) -> T:
    """Return the result of an action; after a transient failure, wait and try again.

    An exception for which ``failure_of`` returns None is raised unchanged. A failed action may have had its
    effect, if only the answer was lost. ``on_wait`` gets a sentence for each wait.
    """
    started_s = time.monotonic()
    asked_s = 0.0
    waits = list(waits_s)
    while True:
        try:
            return action()
        except Exception as error:
            failure = failure_of(error)
            if failure is None:
                raise
            asked_s += failure.asked_wait_s
            is_over = not waits or asked_s > ASKED_WAIT_S
            if is_over or not failure.is_transient or time.monotonic() - started_s + waits[0] > patience_s:
                raise failure.error from None  # what the client raised may quote keys
        wait_s = max(waits.pop(0), failure.asked_wait_s)
        on_wait(f"{failure.error.what}; trying again in {wait_s:g} s")
        time.sleep(wait_s)


class TooSlowError(TimeoutError):
    """An answer, or a part of one, is late."""


def in_time(action: Callable[[], T], size_bytes: int = 0) -> T:
    """Return the result of an action that asks a server once, or raise TooSlowError.

    ``size_bytes`` are sent or arrive. The action cannot be stopped; a late result is closed, if possible.
    """
    done: Future[T] = Future()

    def run() -> None:
        try:
            done.set_result(action())
        except BaseException as error:
            done.set_exception(error)

    limit_s = ANSWER_S + size_bytes / MIN_BYTES_PER_S
    Thread(target=run, daemon=True).start()
    if not wait([done], limit_s).done:
        done.add_done_callback(lambda late: late.exception() or getattr(late.result(), "close", int)())
        raise TooSlowError(f"no whole answer within {limit_s:.3g} s")
    return done.result()


def cause_chain(error: BaseException) -> list[BaseException]:
    """Return an exception and its causes, outermost first."""
    chain: list[BaseException] = []
    link: BaseException | None = error
    while link is not None and link not in chain:
        chain.append(link)
        link = link.__cause__ or link.__context__
    return chain


def _scheme(address: str) -> str:
    """Return the kind of store of an address in canonical form."""
    return address.partition("://")[0]


def _client_of(address: str) -> AbstractFileSystem:
    """Return the client of a store; folders in the same kind of store share it in this process."""
    import fsspec  # takes a tenth of a second to import, and few data sets lie in stores

    scheme = _scheme(address)
    try:
        client = fsspec.filesystem(scheme, **_options(scheme, fsspec.config.conf))
    except ImportError as error:
        package = _PACKAGES.get(scheme)
        if package is None:
            problem = f"the client for {scheme + '://'!r} is not installed ({error})"
            raise InputError(f"{address!r}: {problem}", next="install that package") from error
        if scheme == "s3":
            raise MissingExtraError(repr(address), package, "s3") from error
        missing = f"{address!r} needs the package {package!r}, which is not installed"
        raise InputError(missing, next=f"pip install {package}") from error
    except ValueError as error:
        raise InputError(
            f"{address!r}: no store is known by {scheme + '://'!r}",
            next="give a folder or s3://BUCKET/FOLDER",
        ) from error
    if scheme == "s3":
        client.retries = 1  # see _LIMITS
    # Failures are reported here; without a log handler, gcsfs prints them with tracebacks.
    logging.getLogger(type(client).__module__.partition(".")[0]).addHandler(logging.NullHandler())
    return client


def _options(scheme: str, configured: JsonObject) -> JsonDict:
    """Return options for the client of a store: no listings are kept, because others write there, too."""
    if scheme == "hf":
        return {}  # a commit never changes
    if scheme != "s3":
        return {"use_listings_cache": False}
    # Options given here override fsspec's own configuration; what the user sets there must hold.
    own = configured.get("s3", {}).get("config_kwargs", {})
    return {"use_listings_cache": False, "config_kwargs": {**_LIMITS, **own}}


def ask_store(action: Callable[[], T], doing: str, address: str, size_bytes: int = 0) -> T:
    """Do something with a file of a store; ``doing`` names it in messages, such as ``"reading"``.

    ``size_bytes`` are sent or arrive; the time limit grows with them. Raises FileNotFoundError and
    FileExistsError unchanged, InputError for a name that no bucket or file can have, IntegrityError for a
    file that was replaced while it was read, and RemoteError for other failures of the store.
    """
    failure = partial(_store_failure, doing=doing, address=address)
    return with_retry(partial(in_time, action, size_bytes), failure, _WAITS_S, patience_s=_PATIENCE_S)


class _Stream(io.BufferedIOBase):
    """A file of a store, read piece by piece."""

    def __init__(self, stream: JsonValue, address: str) -> None:
        super().__init__()
        self._stream, self._address = stream, address
        self.details: JsonObject | None = getattr(stream, "details", None)
        self.seek, self.tell = stream.seek, stream.tell  # type: ignore[method-assign]

    def read(self, size: int | None = -1) -> bytes:
        position = self._stream.tell()

        is_part = size is not None and size >= 0

        def read() -> bytes:
            self._stream.seek(position)
            return bytes(self._stream.read(size if is_part else -1))

        size_bytes = size if is_part else getattr(self._stream, "size", None)
        return ask_store(read, "reading", self._address, size_bytes or 0)

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def close(self) -> None:
        self._stream.close()
        super().close()


def _store_failure(error: Exception, doing: str, address: str) -> CallFailure | None:
    """Return the failure for an exception of the client of a store; None for any other exception."""
    chain = cause_chain(error)
    if isinstance(error, (FileNotFoundError, FileExistsError)) or any(
        isinstance(link, ToolkitError) for link in chain
    ):
        return None
    status = next((code for code in map(_code_of, chain) if code is not None), None)
    is_silent = status is None and any(
        isinstance(link, (ConnectionError, TimeoutError)) or _CONNECTION.search(type(link).__name__)
        for link in chain
    )
    words = [status or "", *(type(link).__name__ for link in chain)]
    if is_silent:
        words.append(_NO_ANSWER)
    causes = " ".join(words)
    of_client = [link for link in chain if _is_of_client(link)]
    answer = (redact(str([error, *of_client][-1])).strip().splitlines() or [""])[0][:300]
    values = {
        "address": address,
        "doing": doing,
        "code": status or type(error).__name__,
        "answer": answer or type([error, *of_client][-1]).__name__,
    }
    for pattern, kind, what, then in _SENTENCES:
        is_of_store = pattern or status is not None or of_client or isinstance(error, OSError)
        if is_of_store and re.search(pattern, causes):
            is_transient = is_silent or bool(_TRANSIENT.match(status or ""))
            return CallFailure(kind(what.format(**values), next=then), is_transient)
    return None


def _code_of(link: BaseException) -> str | None:
    """Return the code or status that a store gives for a failure."""
    response = getattr(link, "response", None)
    if isinstance(response, Mapping):
        return str(response.get("Error", {}).get("Code", ""))
    status = getattr(response, "status_code", None)
    if status is None and _is_of_client(link):
        status = getattr(link, "code", None) or getattr(link, "status", None)
    if isinstance(status, int):
        return str(status)
    return None


def _is_of_client(link: BaseException) -> bool:
    # For an answer that ends too early, the parser of aiohttp raises an error with a status code of its own.
    if type(link).__module__ == "aiohttp.http_exceptions":
        return False
    return any(kind.__module__.partition(".")[0] in _CLIENTS for kind in type(link).__mro__)


@dataclass(frozen=True)
class FsspecFolder(DataFolder):
    """A data set folder in a store of objects, by its address."""

    root: str
    is_local: ClassVar[bool] = False

    def __reduce__(self) -> tuple[object, ...]:
        return FsspecFolder, (self.root,)  # without open connections

    @cached_property
    def _client(self) -> AbstractFileSystem:
        return _client_of(self.root)

    def _ask(self, action: Callable[[], T], doing: str, path: str, size_bytes: int = 0) -> T:
        return ask_store(action, doing, self.address(path), size_bytes)

    def _key(self, path: str = "") -> str:
        """Return the key of a file, as the client names it."""
        return str(self._client._strip_protocol(self.address(path))).rstrip("/")

    def problem(self) -> str:
        """Return why the folder cannot hold files, or ``""`` if it can."""
        bucket = self._key().partition("/")[0]
        if _scheme(self.root) in _PACKAGES and self._info(bucket, "") is None:
            return f"the bucket {bucket!r} of {self.root!r} does not exist"
        return ""

    def info(self, path: str) -> JsonObject | None:
        """Return type and size of a file or folder, and values that change with it; None if there is none."""
        return self._info(self._key(path), path)

    def _info(self, key: str, path: str) -> JsonObject | None:
        with contextlib.suppress(FileNotFoundError):
            facts: JsonObject = self._ask(lambda: self._client.info(key), "reading", path)
            return facts
        return None

    def entries(self, folder: str = "") -> dict[str, int | None]:
        """List names directly in a sub-folder, sorted, with sizes in bytes, None for what is not a file."""
        key = self._key(folder)
        sizes = dict[str, int | None]()
        with contextlib.suppress(FileNotFoundError):
            for entry in self._ask(lambda: self._client.ls(key, detail=True), "listing", folder):
                name = entry["name"].strip("/")
                # A file, and the mark of an empty folder, are listed in themselves.
                if name != key.strip("/"):
                    is_file = entry["type"] != "directory"
                    sizes[name.rpartition("/")[2]] = int(entry["size"]) if is_file else None
        return dict(sorted(sizes.items()))

    def open(self, path: str) -> IO[bytes]:
        """Open a file for reading piece by piece; a file that is replaced is not read on."""
        key = self._key(path)
        stream = self._ask(lambda: self._client.open(key, "rb", block_size=_READ_AHEAD), "reading", path)
        # `tactile_toolkit.hub` has the messages for failures of the Hub.
        return cast(IO[bytes], stream if _scheme(self.root) == "hf" else _Stream(stream, self.address(path)))

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
        """Return options so that a killed writer leaves no pieces, which cost money and are not listed."""
        if _scheme(self.root) == "s3":
            return {"chunksize": len(content) + 1}
        return {}

    def upload(self, path: str, source: Path) -> None:
        """Write a copy of a file of this machine in pieces."""
        options = _UPLOAD_OPTIONS.get(_scheme(self.root), {})
        size_bytes = source.stat().st_size
        self._put(path, size_bytes, lambda key: self._client.put_file(str(source), key, **options))

    def write(self, path: str, fill: Callable[[IO[bytes]], T]) -> T:
        """Let ``fill`` write a file in ``$TMPDIR``, and upload it; return what ``fill`` returns."""
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
            if _scheme(self.root) in _PACKAGES:
                raise self._no_bucket() from error
            parent = key.rpartition("/")[0]
            self._ask(lambda: self._client.makedirs(parent, exist_ok=True), "writing", path)
            self._ask(lambda: put(key), "writing", path, size_bytes)

    def download(self, path: str, target: Path) -> None:
        """Copy a file to a local one; FileNotFoundError where there is none."""
        target.parent.mkdir(parents=True, exist_ok=True)
        key = self._key(path)
        size_bytes = self.size_bytes(path)
        self._ask(lambda: self._client.get_file(key, str(target)), "reading", path, size_bytes)

    def remove(self, path: str) -> None:
        """Remove a file, if it exists."""
        self._require_writable(path)
        with contextlib.suppress(FileNotFoundError):
            self._ask(lambda: self._client.rm_file(self._key(path)), "removing", path)

    def require_folder(self) -> None:
        """Raise InputError if there is a file of that name, or if the bucket does not exist."""
        self._require_writable("")
        facts = self.info("")
        if facts is not None and facts["type"] == "file":
            raise InputError(
                f"{self.root!r} is a file; expected a folder", next="choose another path (--out or OUT)"
            )
        if facts is None and self.problem():
            raise self._no_bucket()

    def remove_temporaries(self) -> None:
        """Do nothing: an unfinished file is not in the store."""

    def refresh(self, folder: str) -> None:
        """Do nothing: listings are never kept."""

    def _no_bucket(self) -> InputError:
        return InputError(
            f"{self.problem()}; nothing was written, and no bucket was made",
            next="check its name, or make it with the store's own tools",
        )

    def _require_writable(self, path: str) -> None:
        if _scheme(self.root) == "hf":
            raise InputError(
                f"{self.address(path)!r} cannot be written to: the Hub takes whole commits",
                next="write to a folder or to s3://BUCKET/FOLDER, then send it with the command `upload`",
            )
