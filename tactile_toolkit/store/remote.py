"""Folders in object stores, through fsspec: what other processes write is seen, what goes wrong is named.

Nothing is remembered of what a store said: listings of fsspec's clients are kept for good otherwise, and
another process may write there at any moment. Objects appear whole. No bucket is ever made.
"""

from __future__ import annotations

import io
import logging
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import IO, Any, TypeVar, cast

from tactile_toolkit.errors import InputError, IntegrityError, MissingExtraError, RemoteError, ToolkitError
from tactile_toolkit.store.address import scheme_of, shown

__all__ = ["RemoteFolder", "failure_of"]

_READ_AHEAD_BYTES = 1 << 20
_PATIENCE_S = 30.0
"""For so long what fails in passing is tried again, once the store has answered."""
_FIRST_PATIENCE_S = 10.0
"""The same before it has: an address that was mistyped never answers."""
_LIMITS = {"connect_timeout": 5, "read_timeout": 20, "retries": {"total_max_attempts": 1}}
"""Of the client of S3, which would try five times what is tried again here, within one time limit."""

T = TypeVar("T")


@dataclass(frozen=True)
class RemoteFolder:
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
            raise _not_installed(self.address, scheme, error) from error
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

    def write(self, path: str, content: bytes) -> None:
        """Write a whole file in place of any other."""
        self._put(path, content, lambda options: self._system.pipe_file(self._key(path), content, **options))

    def create(self, path: str, content: bytes) -> bool:
        """Write a whole file unless there is one; tell whether this call did.

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

    def upload(self, path: str, source: str) -> None:
        """Copy a local file to the store, in pieces where it is large, two of which are held at a time."""
        key, options = self._key(path), {"max_concurrency": 2} if scheme_of(self.address) == "s3" else {}
        self._require_writable(path)
        try:
            self._asked(lambda: self._system.put_file(source, key, **options), "writing", path)
        except FileNotFoundError as error:
            raise self._no_bucket() from error

    def download(self, path: str, target: str) -> None:
        """Copy a file of the store to a local one, whose folder must be there; raises FileNotFoundError."""
        self._asked(lambda: self._system.get_file(self._key(path), target), "reading", path)

    def remove(self, path: str) -> None:
        """Remove a file, if it is there."""
        self._require_writable(path)
        try:
            self._asked(lambda: self._system.rm_file(self._key(path)), "removing", path)
        except FileNotFoundError:
            return

    def require_writable(self) -> None:
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
                if not _is_passing(error) or waited_s > patience_s:
                    raise failure from _shown_cause(error)
                time.sleep(wait_s)
                wait_s *= 2
            else:
                if not self._met:
                    self._met.append(True)
                return done


class _Stream(io.BufferedIOBase):
    """A file of a store, read piece by piece."""

    def __init__(self, folder: RemoteFolder, path: str, stream: Any) -> None:
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


_PACKAGES = {"s3": "s3fs", "gs": "gcsfs", "abfs": "adlfs", "az": "adlfs"}


def _not_installed(address: str, scheme: str, error: ImportError) -> InputError:
    package = _PACKAGES.get(scheme)
    if scheme == "s3":
        return MissingExtraError(f"{address!r}", "s3fs", "s3")
    what = f"the package {package!r}" if package else "a package"
    told = "" if package else f" ({error})"
    name = package or "the one that it names"
    return InputError(f"{address!r} needs {what}, which is not installed{told}; next: pip install {name}")


_CLIENTS = {"botocore", "aiobotocore", "aiohttp", "gcsfs", "google", "huggingface_hub", "httpx", "httpcore"}
_CLIENTS |= {"requests", "urllib3", "s3fs", "azure", "adlfs", "fsspec", "httpx2", "httpcore2"}
_NO_CREDENTIALS = {
    "NoCredentialsError",
    "PartialCredentialsError",
    "CredentialRetrievalError",
    "ProfileNotFound",
    "TokenRetrievalError",
    "SSOTokenLoadError",
    "UnauthorizedSSOTokenError",
    "DefaultCredentialsError",
    "RefreshError",
}
_WRONG_CREDENTIALS = {"InvalidAccessKeyId", "SignatureDoesNotMatch", "InvalidToken", "AuthFailure", "401"}
_EXPIRED = {"ExpiredToken", "TokenRefreshRequired", "RequestExpired"}
_ELSEWHERE = {"PermanentRedirect", "AuthorizationHeaderMalformed", "301", "307", "IllegalLocationConstraint"}
_BAD_NAMES = {"InvalidBucketName", "ParamValidationError", "NoSuchBucketName"}
_PASSING = {"SlowDown", "InternalError", "ServiceUnavailable", "RequestTimeout", "OperationAborted"}
_PASSING |= {"Throttling", "ThrottlingException", "ConditionalRequestConflict", "RequestLimitExceeded"}
_PASSING |= {"408", "429", "500", "502", "503", "504"}
_BROKEN = {"ConnectionClosedError", "IncompleteRead", "IncompleteReadError", "ClientPayloadError"}
_BROKEN |= {"ResponseStreamingError", "ServerDisconnectedError", "HTTPClientError", "ClientOSError"}
_CREDENTIALS_STEP = (
    "next: give credentials as the store's own tools take them (for S3: AWS_PROFILE, AWS_ACCESS_KEY_ID and "
    "AWS_SECRET_ACCESS_KEY, or `aws configure`)"
)


def failure_of(error: Exception, doing: str, address: str) -> ToolkitError | None:
    """Name a failure of a store; None for one that has nothing to do with it.

    ``doing`` says what was done there, such as ``"reading"``.
    """
    chain = list(_chain(error))
    if any(isinstance(link, ToolkitError) for link in chain):
        return None
    names, code = {type(link).__name__ for link in chain}, _code_of(chain)
    where = repr(address)
    if "FileExpired" in names:
        return IntegrityError(f"{where} was replaced while it was read; next: run the same command again")
    if names & _NO_CREDENTIALS:
        return RemoteError(
            f"{where} needs credentials, and none can be used here ({_said(chain)}); {_CREDENTIALS_STEP}"
        )
    if code in _EXPIRED:
        return RemoteError(
            f"the credentials for {where} have expired ({code}); next: renew them, and run it again"
        )
    if code == "RequestTimeTooSkewed":
        return RemoteError(f"{where}: the clock of this machine is wrong, says the store; next: set it right")
    if code in _WRONG_CREDENTIALS:
        return RemoteError(f"{where}: the store does not take the credentials ({code}); {_CREDENTIALS_STEP}")
    if code == "400" and "ClientError" in names:  # the answer of S3 to a question for the head of a file
        message = (
            f"{where}: the store answers '400 Bad Request' and gives no reason, as S3 does for a wrong "
            "region or expired credentials; next: set AWS_DEFAULT_REGION to the region of the bucket, check "
            "AWS_ENDPOINT_URL if you set it, and renew the credentials"
        )
        return RemoteError(message)
    if "RecursionError" in names:
        return RemoteError(
            f"{where}: the store sends its client in a circle, as for a bucket of another region; next: set "
            "AWS_DEFAULT_REGION to that of the bucket"
        )
    if code in _ELSEWHERE:
        message = (
            f"{where} lies in another region ({code}); next: set AWS_DEFAULT_REGION to that of the bucket"
        )
        return RemoteError(message)
    if names & _BAD_NAMES or code in _BAD_NAMES:
        return InputError(f"{where} holds no name that a bucket or file can have; next: check it")
    if code == "403" or isinstance(error, PermissionError) or "AccessDenied" in str(code):
        return RemoteError(
            f"{doing} {where} is refused ({code or 'permission denied'}): the store does not know these "
            f"credentials, or they may not do that; {_CREDENTIALS_STEP}, or ask the owner of the bucket"
        )
    if _is_silence(error):
        return RemoteError(
            f"the store of {where} gives no answer ({_said(chain)}); finished files stay; next: check the "
            "network and the address of the store (for S3: AWS_ENDPOINT_URL), and run the same command again"
        )
    if code is not None or any(map(_is_of_client, chain)) or isinstance(error, OSError):
        told = f"{code}: {_said(chain)}" if code else _said(chain)
        return RemoteError(
            f"{doing} {where} failed: {told}; finished files stay; next: run the same command again"
        )
    return None


def _is_passing(error: Exception) -> bool:
    """Tell whether the same request may succeed a little later."""
    return _code_of(list(_chain(error))) in _PASSING or _is_silence(error)


def _is_silence(error: BaseException) -> bool:
    """Tell whether a store gave no answer, or broke off in the middle of one."""
    chain = list(_chain(error))
    if _code_of(chain) is not None:
        return False
    return any(
        isinstance(link, (ConnectionError, TimeoutError))
        or (_is_of_client(link) and re.search("Connect|Timeout", type(link).__name__))
        or type(link).__name__ in _BROKEN
        for link in chain
    )


def _is_of_client(error: BaseException) -> bool:
    # The parser of aiohttp numbers what it cannot read (an answer that ends too early) like a status of HTTP.
    if type(error).__module__ == "aiohttp.http_exceptions":
        return False
    return any(kind.__module__.partition(".")[0] in _CLIENTS for kind in type(error).__mro__)


def _chain(error: BaseException) -> Iterator[BaseException]:
    link: BaseException | None = error
    seen: list[BaseException] = []
    while link is not None and link not in seen:
        yield link
        seen.append(link)
        link = link.__cause__ or link.__context__


def _code_of(chain: list[BaseException]) -> str | None:
    """Return the word or number that a store gives for what went wrong."""
    for link in chain:
        response = getattr(link, "response", None)
        if isinstance(response, Mapping):
            return str(response.get("Error", {}).get("Code", ""))
        status = getattr(response, "status_code", None)
        if status is None and _is_of_client(link):
            status = getattr(link, "code", None) or getattr(link, "status", None)
        if isinstance(status, int):
            return str(status)
    return None


_SECRET_VARIABLES = ("AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN", "AWS_ACCESS_KEY_ID", "HF_TOKEN")
_ACCESS_KEY = re.compile(r"\b(?:AKIA|ASIA)[A-Z0-9]{12,}\b|\bhf_[A-Za-z0-9]{6,}")
_ADDRESS = re.compile(r"\w+://[^\s'\"<>]+")


def _hidden(text: str) -> str:
    """Return a text without keys, tokens and signatures."""
    for name in _SECRET_VARIABLES:
        if os.environ.get(name):
            text = text.replace(os.environ[name], "***")
    return _ADDRESS.sub(lambda match: shown(match[0]), _ACCESS_KEY.sub("***", text))


def _said(chain: list[BaseException]) -> str:
    """Return the first line of what the innermost error of a client says, or else its kind."""
    link = next((each for each in reversed(chain) if _is_of_client(each)), chain[0])
    first = (_hidden(str(link)).strip().splitlines() or [""])[0][:300]
    return first or type(link).__name__


def _shown_cause(error: Exception) -> Exception | None:
    """Return an error as the cause to show; None when its text holds a secret."""
    texts = [str(link) for link in _chain(error)]
    return error if all(_hidden(text) == text for text in texts) else None
