"""Stores, through fsspec: what other processes write is seen, what goes wrong is named.

Nothing is remembered of what a store said: listings of fsspec's clients are kept for good otherwise, and
another process may write there at any moment. What fails becomes one error that says what to do, without keys
and signatures, which the clients of stores may quote. The clients' own types are known by name alone, so that
none of those packages has to be there; several wrap what happened to them in an error of Python's without a
word.
"""

from __future__ import annotations

import io
import logging
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import IO, Any, TypeVar, cast

from tactile_toolkit.errors import InputError, IntegrityError, MissingExtraError, RemoteError, ToolkitError
from tactile_toolkit.store.address import scheme_of, shown

_READ_AHEAD_BYTES = 1 << 20
_PATIENCE_S = 20.0
"""For so long what fails in passing is tried again."""
_LIMITS = {"connect_timeout": 5, "read_timeout": 20, "retries": {"total_max_attempts": 1}}
"""Of the client of S3, which would try five times what is tried again here, within one time limit."""
_PACKAGES = {"s3": "s3fs", "gs": "gcsfs", "abfs": "adlfs", "az": "adlfs"}
"""Of stores with buckets, the client of each."""

T = TypeVar("T")


@dataclass(frozen=True)
class Store:
    """The store of an address such as ``s3://BUCKET/FOLDER``, in the form of ``address.place_of_data``."""

    address: str

    @property
    def has_buckets(self) -> bool:
        """Whether files of this kind of store lie in buckets."""
        return scheme_of(self.address) in _PACKAGES

    @cached_property
    def system(self) -> Any:
        """The client, shared in this process by all folders of the same kind of store."""
        import fsspec

        scheme = scheme_of(self.address)
        try:
            system = fsspec.filesystem(scheme, **_options(scheme))
        except ImportError as error:
            if scheme == "s3":
                raise MissingExtraError(repr(self.address), "s3fs", "s3") from error
            package = _PACKAGES.get(scheme, "of this kind of store")
            missing = f"{self.address!r} needs the package {package!r}, which is not installed"
            raise InputError(missing, next=f"pip install {package}") from error
        except ValueError as error:
            raise InputError(
                f"{self.address!r}: no store is known by {scheme + '://'!r}",
                next="give a folder or s3://BUCKET/FOLDER",
            ) from error
        if scheme == "s3":
            system.retries = 1  # see _LIMITS
        # What goes wrong is said here; where nobody listens to its log, gcsfs prints it with tracebacks.
        logging.getLogger(type(system).__module__.partition(".")[0]).addHandler(logging.NullHandler())
        return system

    def ask(self, action: Callable[[], T], doing: str, path: str) -> T:
        """Do something with the store; what fails in passing is tried again for a while.

        ``doing`` says, for messages, what is done with the file of that path. Raises FileNotFoundError and
        FileExistsError as they are, all else as RemoteError.
        """
        address = f"{self.address}/{path}" if path else self.address
        began_s, wait_s = time.monotonic(), 0.5
        while True:
            try:
                return action()
            except (FileNotFoundError, FileExistsError):
                raise
            except Exception as error:
                failure = _Failure(error)
                said = failure.as_error(doing, address)
                if said is None:
                    raise
                if not failure.is_passing or time.monotonic() - began_s + wait_s > _PATIENCE_S:
                    raise said from (None if failure.holds_secrets else error)
            time.sleep(wait_s)
            wait_s *= 2

    def open(self, key: str, path: str) -> IO[bytes]:
        """Open a file for reading piece by piece; FileNotFoundError where there is none."""
        stream = self.ask(lambda: self.system.open(key, "rb", block_size=_READ_AHEAD_BYTES), "reading", path)
        # Whoever reads from the Hub names its failures.
        return cast(IO[bytes], stream if scheme_of(self.address) == "hf" else _Stream(self, path, stream))


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


class _Stream(io.BufferedIOBase):
    """A file of a store, read piece by piece."""

    def __init__(self, store: Store, path: str, stream: Any) -> None:
        super().__init__()
        self._store, self._path, self._stream = store, path, stream
        self.details: Mapping[str, Any] | None = getattr(stream, "details", None)
        self.seek, self.tell = stream.seek, stream.tell  # type: ignore[method-assign]

    def read(self, size: int | None = -1) -> bytes:
        position = self._stream.tell()

        def ask() -> bytes:
            self._stream.seek(position)
            return bytes(self._stream.read(-1 if size is None else size))

        return self._store.ask(ask, "reading", self._path)

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def close(self) -> None:
        self._stream.close()
        super().close()


_CLIENTS = {"botocore", "aiobotocore", "aiohttp", "gcsfs", "google", "huggingface_hub", "httpx", "httpcore"}
_CLIENTS |= {"requests", "urllib3", "s3fs", "azure", "adlfs", "fsspec", "httpx2", "httpcore2"}
_PASSING = {"SlowDown", "InternalError", "ServiceUnavailable", "RequestTimeout", "OperationAborted"}
_PASSING |= {"Throttling", "ThrottlingException", "ConditionalRequestConflict", "RequestLimitExceeded"}
_PASSING |= {"408", "429", "500", "502", "503", "504"}
_BROKEN = {"ConnectionClosedError", "IncompleteRead", "IncompleteReadError", "ClientPayloadError"}
_BROKEN |= {"ResponseStreamingError", "ServerDisconnectedError", "HTTPClientError", "ClientOSError"}
_CREDENTIALS = (
    "next: give credentials as the store's own tools take them (for S3: AWS_PROFILE, AWS_ACCESS_KEY_ID and "
    "AWS_SECRET_ACCESS_KEY, or `aws configure`)"
)
# The codes and the types of errors that a sentence is for.
_SENTENCES: tuple[tuple[str, str], ...] = (
    ("NoCredentialsError PartialCredentialsError CredentialRetrievalError ProfileNotFound "
     "TokenRetrievalError SSOTokenLoadError UnauthorizedSSOTokenError DefaultCredentialsError RefreshError",
     f"{{where}} needs credentials, and none can be used here ({{answer}}); {_CREDENTIALS}"),
    ("ExpiredToken TokenRefreshRequired RequestExpired",
     "the credentials for {where} have expired ({code}); next: renew them, and run it again"),
    ("RequestTimeTooSkewed",
     "{where}: the store reports that the clock of this machine is wrong; next: set it right"),
    ("InvalidAccessKeyId SignatureDoesNotMatch InvalidToken AuthFailure 401",
     f"{{where}}: the store does not take the credentials ({{code}}); {_CREDENTIALS}"),
    # The answer of S3 to a question for the head of a file.
    ("400",
     "{where}: the store answers '400 Bad Request' and gives no reason, as S3 does for a wrong region or "
     "expired credentials; next: set AWS_DEFAULT_REGION to the region of the bucket, check AWS_ENDPOINT_URL "
     "if you set it, and renew the credentials"),
    # A client that is sent on and on ends in a RecursionError.
    ("PermanentRedirect AuthorizationHeaderMalformed 301 307 IllegalLocationConstraint RecursionError",
     "{where} lies in another region ({code}); next: set AWS_DEFAULT_REGION to that of the bucket"),
    ("403 AccessDenied AccessDeniedException AllAccessDisabled PermissionError",
     "{doing} {where} is refused ({code}): the store does not know these credentials, or they may not do "
     f"that; {_CREDENTIALS}, or ask the owner of the bucket"),
)  # fmt: skip
_NO_ANSWER = (
    "the store of {where} gives no answer ({answer}); finished files stay; next: check the network and the "
    "address of the store (for S3: AWS_ENDPOINT_URL), and run the same command again"
)
_OTHER = "{doing} {where} failed: {code}: {answer}; finished files stay; next: run the same command again"
_SECRET_VARIABLES = ("AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN", "AWS_ACCESS_KEY_ID", "HF_TOKEN")
_ACCESS_KEY = re.compile(r"\b(?:AKIA|ASIA)[A-Z0-9]{12,}\b|\bhf_[A-Za-z0-9]{6,}")
_ADDRESS = re.compile(r"\w+://[^\s'\"<>]+")


class _Failure:
    """What a client raised, with all that led to it."""

    def __init__(self, error: Exception) -> None:
        self.chain = list(_chain(error))
        self.names = {type(link).__name__ for link in self.chain}
        self.code = next((code for code in map(_code_of, self.chain) if code is not None), None)
        self.is_silence = self.code is None and any(map(_is_silence, self.chain))
        self.is_passing = self.code in _PASSING or self.is_silence

    def as_error(self, doing: str, address: str) -> ToolkitError | None:
        """Return what is to be raised; None for an error that has nothing to do with a store."""
        if any(isinstance(link, ToolkitError) for link in self.chain):
            return None
        link = next((each for each in reversed(self.chain) if _is_of_client(each)), self.chain[0])
        said = (_hidden(str(link)).strip().splitlines() or [""])[0][:300] or type(link).__name__
        code = self.code or type(self.chain[0]).__name__
        words = {"where": repr(address), "doing": doing, "code": code, "answer": said}
        if "FileExpired" in self.names:
            message = f"{address!r} was replaced while it was read; next: run the same command again"
            return IntegrityError(message)
        if {self.code, *self.names} & {"InvalidBucketName", "NoSuchBucketName", "ParamValidationError"}:
            return InputError(f"{address!r} holds no name that a bucket or file can have; next: check it")
        for causes, sentence in _SENTENCES:
            if {self.code, *self.names} & set(causes.split()):
                return RemoteError(sentence.format(**words))
        if self.is_silence:
            return RemoteError(_NO_ANSWER.format(**words))
        is_of_store = self.code is not None or any(map(_is_of_client, self.chain))
        if is_of_store or isinstance(self.chain[0], OSError):
            return RemoteError(_OTHER.format(**words))
        return None

    @property
    def holds_secrets(self) -> bool:
        """Whether a text of it is not to be shown."""
        return any(_hidden(str(link)) != str(link) for link in self.chain)


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    seen: list[BaseException] = []
    while error is not None and error not in seen:
        yield error
        seen.append(error)
        error = error.__cause__ or error.__context__


def _code_of(link: BaseException) -> str | None:
    """Return the word or number that a store gives for what went wrong."""
    response = getattr(link, "response", None)
    if isinstance(response, Mapping):
        return str(response.get("Error", {}).get("Code", ""))
    status = getattr(response, "status_code", None)
    if status is None and _is_of_client(link):
        status = getattr(link, "code", None) or getattr(link, "status", None)
    return str(status) if isinstance(status, int) else None


def _is_silence(link: BaseException) -> bool:
    """Return whether a store gave no answer, or broke off in the middle of one."""
    name = type(link).__name__
    is_broken = name in _BROKEN or (_is_of_client(link) and re.search("Connect|Timeout", name))
    return bool(is_broken) or isinstance(link, (ConnectionError, TimeoutError))


def _is_of_client(link: BaseException) -> bool:
    # The parser of aiohttp numbers what it cannot read (an answer that ends too early) like a status of HTTP.
    if type(link).__module__ == "aiohttp.http_exceptions":
        return False
    return any(kind.__module__.partition(".")[0] in _CLIENTS for kind in type(link).__mro__)


def _hidden(text: str) -> str:
    """Return a text without keys, tokens and signatures."""
    for name in _SECRET_VARIABLES:
        if os.environ.get(name):
            text = text.replace(os.environ[name], "***")
    return _ADDRESS.sub(lambda match: shown(match[0]), _ACCESS_KEY.sub("***", text))
