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
from tactile_toolkit.store.names import redact, scheme_of

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
    """The store of an address such as ``s3://BUCKET/FOLDER``, in the form of ``names.normalize_uri``."""

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
        # Failures are reported here; without a handler of its log, gcsfs prints them with tracebacks.
        logging.getLogger(type(system).__module__.partition(".")[0]).addHandler(logging.NullHandler())
        return system

    def with_retry(self, action: Callable[[], T], doing: str, path: str) -> T:
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
                failure, is_transient = _failure(error, doing, address)
                if failure is None:
                    raise
                if not is_transient or time.monotonic() - began_s + wait_s > _PATIENCE_S:
                    raise failure from None  # what the client raised may quote keys
            time.sleep(wait_s)
            wait_s *= 2

    def open(self, key: str, path: str) -> IO[bytes]:
        """Open a file for reading piece by piece; FileNotFoundError where there is none."""
        stream = self.with_retry(
            lambda: self.system.open(key, "rb", block_size=_READ_AHEAD_BYTES), "reading", path
        )
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

        def read() -> bytes:
            self._stream.seek(position)
            return bytes(self._stream.read(-1 if size is None else size))

        return self._store.with_retry(read, "reading", self._path)

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def close(self) -> None:
        self._stream.close()
        super().close()


_CLIENTS = {"botocore", "aiobotocore", "aiohttp", "gcsfs", "google", "huggingface_hub", "httpx", "httpcore"}
_CLIENTS |= {"requests", "urllib3", "s3fs", "azure", "adlfs", "fsspec", "httpx2", "httpcore2"}
# What stores and their clients call what went wrong; numbers are those of HTTP.
_TRANSIENT = re.compile(
    "SlowDown|InternalError|Unavailable|RequestTimeout|Aborted|Throttling|Conflict|LimitExceeded|408|429|5.."
)
_CONNECTION = re.compile("Connect|Timeout|Incomplete|Payload|Streaming|HTTPClientError|ClientOSError")
_BAD_NAME = re.compile("InvalidBucketName|NoSuchBucketName|ParamValidation")
# 400 is the answer of S3 to a question for the head of a file; a client that is sent on and on ends in a
# RecursionError.
_ELSEWHERE = re.compile("Redirect|AuthorizationHeader|LocationConstraint|RecursionError|301|307|400")
_REFUSED = re.compile(
    "Credential|Profile|Token|Expired|Auth|Access|Signature|Denied|Permission|Skewed|40[13]|Refresh"
)
_SECRET_VARIABLES = ("AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN", "AWS_ACCESS_KEY_ID", "HF_TOKEN")
_ACCESS_KEY = re.compile(r"\b(?:AKIA|ASIA)[A-Z0-9]{12,}\b|\bhf_[A-Za-z0-9]{6,}")
_ADDRESS = re.compile(r"\w+://[^\s'\"<>]+")


def _failure(error: Exception, doing: str, address: str) -> tuple[ToolkitError | None, bool]:
    """Return what is to be raised for what a client raised, and whether trying again may help.

    None stands for an error that has nothing to do with a store.
    """
    chain = list(_chain(error))
    if any(isinstance(link, ToolkitError) for link in chain):
        return None, False
    status = next((code for code in map(_code_of, chain) if code is not None), None)
    is_silent = status is None and any(map(_is_connection_error, chain))
    code = status or type(error).__name__
    causes = " ".join([status or "", *(type(link).__name__ for link in chain)])
    link = next((each for each in reversed(chain) if _is_of_client(each)), error)
    answer = (_hidden(str(link)).strip().splitlines() or [""])[0][:300] or type(link).__name__
    failure: ToolkitError | None = None
    if "FileExpired" in causes:
        failure = IntegrityError(f"{address!r} was replaced while it was read", next="run it again")
    elif _BAD_NAME.search(causes):
        failure = InputError(f"{address!r} holds no name that a bucket or file can have", next="check it")
    elif _ELSEWHERE.search(causes):
        failure = RemoteError(
            f"{address!r} lies in another region ({code}), or the credentials have expired",
            next="set AWS_DEFAULT_REGION to the region of the bucket, check AWS_ENDPOINT_URL if you set it, "
            "and renew the credentials",
        )
    elif _REFUSED.search(causes):
        failure = RemoteError(
            f"{doing} {address!r} is refused ({code}: {answer})",
            next="give credentials that may do that and have not expired, as the store's own tools take them "
            "(for S3: AWS_PROFILE, AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or `aws configure`), and "
            "check the clock of this machine",
        )
    elif is_silent:
        failure = RemoteError(
            f"the store of {address!r} gives no answer ({answer}); finished files stay",
            next="check the network and the address of the store (for S3: AWS_ENDPOINT_URL), and run the "
            "same command again",
        )
    elif status is not None or isinstance(error, OSError) or any(map(_is_of_client, chain)):
        failure = RemoteError(
            f"{doing} {address!r} failed: {code}: {answer}; finished files stay",
            next="run the same command again",
        )
    return failure, is_silent or bool(_TRANSIENT.match(status or ""))


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


def _is_connection_error(link: BaseException) -> bool:
    """Return whether a store gave no answer, or broke off in the middle of one."""
    return bool(_CONNECTION.search(type(link).__name__)) or isinstance(link, (ConnectionError, TimeoutError))


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
    return _ADDRESS.sub(lambda match: redact(match[0]), _ACCESS_KEY.sub("***", text))
