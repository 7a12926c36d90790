"""Calls of the Hub's client: one sentence for each failure, retries, and limits of answers.

The client raises a dozen kinds of errors, wraps some in others, and has one status for a private repository
and for a missing one; :func:`failure_of` distinguishes them. The client reads answers of any size, however
slow they are: both are limited in its session. Only this file depends on the release of the client.
"""

from __future__ import annotations

import contextlib
import errno
import inspect
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib import import_module
from typing import Any, TypeVar
from urllib.parse import urlsplit

import huggingface_hub

from tactile_toolkit import errors
from tactile_toolkit.store import remote
from tactile_toolkit.value_types import JsonDict

ANSWER_BYTES = 32 << 20
"""Largest unpacked answer that is not a file: a listing of more than 100,000 files."""
WAITS_S = (1.0, 2.0, 4.0, 8.0, 16.0)
"""Waits between attempts, seconds."""

# Errors are known by the names that `_traits` returns, because releases of the client use different HTTP
# libraries: RequestError is of httpx; Timeout and ChunkedEncodingError are of requests (clients before 1.0).
_BUSY = r"\b(?:408|425|429|500|502|503|504)\b"  # not 501: a missing feature stays missing
# The Hub gave no answer of its own, so its latest one still counts.
_SILENT = re.compile(rf"{_BUSY}|\b(?:ConnectionError|TimeoutError|RequestError|Timeout)\b")
# The same call may succeed a little later: overload, a server error, a broken connection.
_PASSING = re.compile(
    rf"{_BUSY}|\b(?:ConnectionResetError|BrokenPipeError|ConnectionAbortedError|RequestError|Timeout"
    r"|ChunkedEncodingError|CutShort)\b"
)
# The client has waited in vain, and has nothing in its cache; the cause of this error says why.
_GIVEN_UP = "LocalEntryNotFoundError"
# Waiting does not help: a network that is down stays down for longer.
_LASTING = re.compile(
    rf"\b(?:ConnectError|ConnectTimeout|LocalProtocolError|UnsupportedProtocol|ProxyError|{_GIVEN_UP})\b"
)
# Raised while an answer of an unexpected form is read.
_UNREADABLE = (ValueError, TypeError, LookupError, AttributeError, RecursionError)
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM)
_FILE_NAME = re.compile(r'(?:W/)?"?\w[\w.-]*"?', re.ASCII)
_FILE_NAMES = ("etag", "x-linked-etag", "x-repo-commit")
_PROXIES = ("HTTPS_PROXY", "HTTP_PROXY", "ALL_PROXY")
_ADDRESSES = ("HF_ENDPOINT", *_PROXIES, *map(str.lower, _PROXIES))
_MAX_S = 1e9  # numbers may have thousands of digits

# The address of a mirror may hold a password.
_USER_OF_ADDRESS = re.compile(r"(https?://)[^\s'\"<>/@]+@")

# The first pattern that matches an error of the chain gives the message: what failed, and the next step.
_SENTENCES = {
    "NoRoom": (
        "{task} failed, the disk cannot be written: {words}",
        "free some space, or choose another place with --out or HF_HOME, and run it again",
    ),
    "GatedRepoError": ("{subject} is gated", "accept its terms at {page}, and {login}"),
    "RepositoryNotFoundError": (
        "{subject} was not found, or is private",
        "check the name, or {login} as a user who may see it",
    ),
    "HFValidationError": ("not a name of a repository: {words}", "give USER/NAME"),
    r"\b401\b|LocalTokenNotFoundError": (
        "{task} needs a valid token",
        "{login}, again if the token is old",
    ),
    r"\b(?:429|5\d\d)\b": (
        "the Hub answered {status} while {task}",
        "try again {wait}; complete files are kept",
    ),
    r"\b\d{3}\b": (
        "the Hub refused {task} ({status}): {words}",
        "correct what it names, or use a token of role `write` and a name of your own",
    ),
    "TooLargeError|FileMetadataError|Unreadable": (
        "{endpoint} does not answer as a Hub does while {task} ({kind}: {words})",
        "check HF_ENDPOINT, and whether the network asks for a login",
    ),
    "RequestError|OSError": (
        "no connection to the Hub at {endpoint} while {task} ({kind}: {words})",
        "check the network, HF_ENDPOINT and HF_HUB_OFFLINE, and run the same command again, it continues",
    ),
}
_CLASSES: dict[str, type[errors.ToolkitError]] = {
    "NoRoom": errors.StorageError,
    "HFValidationError": errors.InputError,
}

T = TypeVar("T")


class TooLargeError(Exception):
    """More bytes arrive than were expected."""


def require_addresses() -> None:
    """Raise InputError for a variable that holds no valid address; the client would quote it."""
    for name in _ADDRESSES:
        with contextlib.suppress(ValueError):
            _ = urlsplit(os.environ.get(name, "")).port
            continue
        raise errors.InputError(
            f"the variable {name} is not an address; expected one such as https://HOST:PORT",
            next="correct it, or unset it",
        )


def public_endpoint() -> str:
    """Return the address of the Hub, without the user and password that HF_ENDPOINT may hold."""
    # The client does not load this module on first use.
    from huggingface_hub import constants

    return _USER_OF_ADDRESS.sub(r"\1", constants.ENDPOINT)


def page_of(repo_id: str) -> str:
    """Return the address of the web page of a repository."""
    return f"{public_endpoint()}/datasets/{repo_id}"


def _traits(error: BaseException) -> str:
    """Return the HTTP status of an error, and the names of its types."""
    names = [kind.__name__ for kind in type(error).__mro__]
    if _GIVEN_UP in names:
        return _GIVEN_UP
    status = getattr(getattr(error, "response", None), "status_code", "")
    no_room = "NoRoom" if getattr(error, "errno", None) in _NO_ROOM else ""
    # The client has no type of its own for a file that is shorter than announced.
    cut_short = "CutShort" if "Consistency check" in str(error) else ""
    return " ".join([str(status), no_room, cut_short, *names])


def _requested_wait_s(headers: Mapping[str, str]) -> float:
    """Return the time that an answer asks to wait, seconds; 0 if it does not."""
    # Such as "api";r=0;t=55: no requests are left for 55 seconds.
    spent = re.search(r"\br=0\s*;\s*t=(\d+)", str(headers.get("RateLimit", "")))
    text = spent[1] if spent else str(headers.get("Retry-After", "")).strip()
    if re.fullmatch("[0-9]+", text):
        return min(float(text), _MAX_S)
    return 0.0


@contextlib.contextmanager
def hub_failures(repo_id: str, doing: str = "reading") -> Iterator[None]:
    """Turn every failure of the Hub, the network and its cache into an error of the toolkit.

    ``doing`` says what is done to the repository: ``"reading"``, ``"uploading to"``, ... Raises HubError (not
    allowed, not found, not reached), StorageError (no space, no permission) or InputError (not a name).
    """
    _limit_session()
    try:
        yield
    except Exception as error:
        failure = failure_of(error, repo_id, doing)
        if failure is None:
            raise
        raise failure.error from None  # the client's exception may quote a token


def not_cached(repo_id: str, what: str) -> errors.HubError:
    """Return the error for something that is not in the cache while the Hub cannot be reached."""
    return errors.HubError(
        f"{what} of Hub data set {repo_id!r} is not in the cache, and the Hub at {public_endpoint()} cannot "
        "be asked now",
        next="check the network, unset HF_HUB_OFFLINE if it is set, and run the same command again",
    )


def failure_of(
    error: Exception, repo_id: str, doing: str = "reading", *, is_answer: bool = False
) -> remote.CallFailure | None:
    """Return the failure for an exception of the client; None for any other exception.

    With ``is_answer`` only an answer of the Hub was read, so an unreadable value is a failure, too.
    """
    chain = remote.cause_chain(error)
    if any(isinstance(link, errors.ToolkitError) for link in chain):
        return None
    traits = [_traits(link) for link in chain]
    if is_answer and isinstance(error, _UNREADABLE):
        traits[0] += " Unreadable"
    responses = (getattr(link, "response", None) for link in chain)
    wait_s = next(
        (_requested_wait_s(response.headers) for response in responses if response is not None), 0.0
    )
    for pattern, sentence in _SENTENCES.items():
        link = next(
            (link for link, names in zip(chain, traits, strict=True) if re.search(pattern, names)), None
        )
        if link is not None:
            values = {
                "subject": f"Hub data set {repo_id!r}",
                "task": f"{doing} Hub data set {repo_id!r}",
                "kind": type(link).__name__,
                "words": str(getattr(link, "server_message", None) or link).strip().partition("\n")[0][:300],
                "status": _traits(link).partition(" ")[0],
                "login": "log in with `hf auth login` (or set HF_TOKEN)",
                "page": page_of(repo_id),
                "endpoint": public_endpoint(),
                "wait": f"in {wait_s:.0f} s" if wait_s else "in some minutes",
            }
            what, then = (
                errors.redact(part.format(**values), huggingface_hub.get_token()) for part in sentence
            )
            raised = _CLASSES.get(pattern, errors.HubError)(what, next=then)
            all_traits = " ".join(traits)
            is_transient = bool(_PASSING.search(all_traits)) and not _LASTING.search(all_traits)
            return remote.CallFailure(raised, is_transient, wait_s)
    return None


def has_answered(error: BaseException) -> bool:
    """Return whether an error is from an answer of the Hub, not from a busy Hub or a broken connection."""
    return not any(_SILENT.search(_traits(link)) for link in remote.cause_chain(error))


def call_with_retry(
    action: Callable[[], T],
    repo_id: str,
    doing: str = "reading",
    *,
    waits_s: tuple[float, ...] | None = None,
    on_wait: Callable[[str], None] = lambda _: None,
) -> T:
    """Return the result of an action; after a transient failure, wait and try again.

    A failed action may have had its effect, if only the answer was lost. ``on_wait`` gets a sentence for each
    wait; the total of the waits that the Hub asks for is limited. Raises as :func:`hub_failures`.
    """
    _limit_session()
    failure = partial(failure_of, repo_id=repo_id, doing=doing, is_answer=True)
    return remote.with_retry(action, failure, WAITS_S if waits_s is None else waits_s, on_wait=on_wait)


def _limit_session() -> None:
    """Let the session of the client limit the size and the time of all answers."""
    require_addresses()
    try:
        # Before 1.0 it is a session of requests, one for each thread.
        session = import_module("huggingface_hub").get_session()
    except Exception as error:
        # Its message may quote an address with a password.
        cause = str(error) if isinstance(error, ImportError) else type(error).__name__
        variables = ", ".join(name for name in _ADDRESSES if name in os.environ)
        raise errors.InputError(
            f"the client of the Hub cannot be set up ({cause}); set are {variables or 'no addresses'}",
            next="correct these variables, or unset them",
        ) from None
    hooks = session.event_hooks if hasattr(session, "event_hooks") else session.hooks
    if _check_answer not in hooks["response"]:
        hooks["response"].append(_check_answer)
        session.send = partial(_send, session.send)


def _send(send: Callable[..., Any], request: Any, *, stream: bool = False, **options: object) -> Any:
    """Send a request of the client's session, and limit the time until the header of the answer arrives."""
    if request.method not in ("GET", "HEAD"):  # it may send a file
        return send(request, stream=stream, **options)
    response = remote.in_time(partial(send, request, stream=True, **options))
    if not stream:
        # The session reads the answer.
        getattr(response, "read", lambda: response.content)()
    return response


def _timed(pieces: Callable[..., Iterator[bytes]], *arguments: object) -> Iterator[bytes]:
    """Yield the pieces of an answer while it is fast enough; the time of the reader does not count."""
    waited_s = 0.0
    arrived = 0
    source = pieces(*arguments)
    while True:
        begun_s = time.monotonic()
        piece = next(source, None)
        if piece is None:
            return
        waited_s = waited_s + time.monotonic() - begun_s
        arrived = arrived + len(piece)
        if waited_s > remote.ANSWER_S + arrived / remote.MIN_BYTES_PER_S:
            raise remote.TooSlowError(f"{arrived:,} bytes came within {waited_s:.0f} s")
        yield piece


def _check_answer(response: Any, **_: object) -> None:
    """Limit the body of an answer, and refuse one with a bad header."""
    request = response.request
    # The client names files in its cache by these.
    for name in _FILE_NAMES * (request.method == "HEAD"):
        value = response.headers.get(name, "none")
        if not _FILE_NAME.fullmatch(value):
            raise errors.HubError(
                f"the Hub calls a file {value[:80]!r}, which is not a digest", next="check HF_ENDPOINT"
            )
    if re.fullmatch(_BUSY, str(response.status_code)) and _requested_wait_s(response.headers):
        # Raised at once: the caller waits, and can report the reason.
        import_module("huggingface_hub.utils").hf_raise_for_status(response)
    if hasattr(response, "iter_raw"):  # releases before 1.0 limit only the time of the header
        response.iter_raw = partial(_timed, response.iter_raw)
    path = urlsplit(str(request.url)).path
    if response.status_code // 100 == 2 and "/api/" not in path.partition("/resolve/")[0]:
        return  # a file of any size
    name = "iter_bytes" if hasattr(response, "iter_bytes") else "iter_content"  # in requests
    pieces = getattr(response, name)

    def limited(*args: object, **options: object) -> Iterator[bytes]:
        arrived = 0
        for piece in pieces(*args, **options):
            arrived += len(piece)
            if arrived > ANSWER_BYTES:
                raise TooLargeError(f"more than the {ANSWER_BYTES:,} bytes that were expected")
            yield piece

    setattr(response, name, limited)


def counting_options(count: Callable[[int], None]) -> JsonDict:
    """Return options with which the client reports the bytes of a file that have arrived, if it can."""
    from huggingface_hub.utils.tqdm import tqdm  # only once addresses are known to be valid

    class Bar(tqdm):
        """Reports the bytes that are written to the disk."""

        monitor_interval = 0  # no watching thread

        def __init__(self, *_: object, **__: object) -> None:
            super().__init__(disable=True)  # type: ignore[no-untyped-call]
            count(0)

        def update(self, n: float | None = 1) -> None:
            self.n += int(n or 0)
            count(self.n)

        def update_transfer(self, n: float | None = 1) -> None:
            """Ignore bytes of compressed transfers."""

        set_transfer_postfix_str = tqdm.set_postfix_str

    if "tqdm_class" in inspect.signature(huggingface_hub.hf_hub_download).parameters:
        return {"tqdm_class": Bar}
    return {}
