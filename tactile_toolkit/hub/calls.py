"""Calls of the Hub's client: how much an answer may cost, and trying again what fails for the moment.

The client takes whatever comes for as long as it comes, and waits as long as it is asked to. The hooks of its
session limit bytes and time of all that goes through it: questions, downloads, reading piece by piece.
"""

from __future__ import annotations

import contextvars
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib import import_module
from multiprocessing.pool import ThreadPool
from typing import Any, TypeVar
from urllib.parse import urlsplit

from tactile_toolkit.errors import HubError
from tactile_toolkit.hub.errors import (
    cause_chain,
    class_names,
    failure_of,
    requested_s,
    requested_wait_s,
    shown_cause,
    status_of,
)
from tactile_toolkit.store.names import problem_of_name

ANSWER_BYTES = 32 << 20
"""Largest answer to a question, unpacked: a listing of more than 100,000 files."""
QUESTION_S = 30.0
"""Longest time for a question to the Hub with its answer, seconds."""
WAIT_S = 120.0
"""Longest time to wait for the Hub, because it asks for it or for the next piece of a file, seconds."""
LEAST_BYTES = 16 << 10
"""What of an answer has to arrive in that time: less is as good as nothing."""
WAITS_S = (1.0, 2.0, 4.0, 8.0, 16.0)
"""Waits between tries, seconds."""

# Too slow, too early, too many, and a server in trouble; 501 stays, as what is not offered will not be.
_TRANSIENT_STATUS = frozenset({408, 425, 429, 500, 502, 503, 504})
# RequestError is of httpx; Timeout and ChunkedEncodingError are of requests, which clients before 1.0 have.
_SILENCE = frozenset({"ConnectionError", "TimeoutError", "RequestError", "Timeout"})
_BROKEN = frozenset(
    {
        *("ConnectionResetError", "BrokenPipeError", "ConnectionAbortedError"),
        *("RequestError", "Timeout", "ChunkedEncodingError"),
    }
)
# What a longer wait than anyone's patience would not mend, and what the client has waited for in vain.
_LASTING = frozenset(
    {"ConnectError", "ConnectTimeout", "LocalProtocolError", "UnsupportedProtocol", "ProxyError"}
)
_RANGE = re.compile(r"bytes=(\d+)-(\d+)")

T = TypeVar("T")


class TooLargeError(Exception):
    """More arrives than was asked for."""


@dataclass
class _Call:
    """When the latest answer to a call began, and how large a file may be that it fetches."""

    most_bytes: float
    began_s: float = field(default_factory=time.monotonic)


_CALL: contextvars.ContextVar[_Call | None] = contextvars.ContextVar("_CALL", default=None)


def call_with_retry(
    action: Callable[[], T],
    repo_id: str,
    revision: str | None = None,
    doing: str = "reading",
    *,
    waits_s: tuple[float, ...] | None = None,
    is_question: bool = True,
    most_bytes: float = float("inf"),
    on_wait: Callable[[str], None] = lambda _: None,
) -> T:
    """Return what an action gives; what fails for the moment is tried again after growing waits.

    The action may have had its effect though it failed, where the answer was lost. ``on_wait`` gets a
    sentence for each wait; all waits that the Hub asks for are limited together. What ``is_question`` (all
    but sending and fetching files) has a limit of time, and other answers are of ``most_bytes``. Raises what
    :func:`tactile_toolkit.hub.errors.named_failures` does, with the number of tries.
    """
    waits = WAITS_S if waits_s is None else waits_s
    tries, waited_s = 0, 0.0
    while True:
        tries += 1
        try:
            return _limited_call(action, _Call(most_bytes), is_question=is_question)
        except Exception as error:
            failure = failure_of(error, repo_id, revision, doing, tries, is_answer=True)
            if failure is None:
                raise
            requested_s = requested_wait_s(error)
            waited_s += requested_s
            if tries > len(waits) or not is_transient(error) or waited_s > WAIT_S:
                raise failure from shown_cause(error)
            wait_s = max(waits[tries - 1], requested_s)
            what = str(failure).partition("; next: ")[0].partition(" (tried ")[0]
            on_wait(f"{what}; trying again in {wait_s:g} s")
        time.sleep(wait_s)


def is_transient(error: BaseException) -> bool:
    """Return whether the same request may succeed a little later.

    So do overload, a server's trouble, and a connection that broke; not so a Hub that could not be reached in
    the first place (no network stays no network for longer than anyone wants to wait), nor any refusal.
    """
    chain = cause_chain(error)
    names = [set(class_names(link)) for link in chain]
    if any("LocalEntryNotFoundError" in each for each in names):  # the client has tried for long enough
        return False
    statuses = [status for status in map(status_of, chain) if status is not None]
    if statuses:
        return statuses[0] in _TRANSIENT_STATUS
    # The client has no type of its own for a file that is shorter than was announced.
    is_cut_short = any("Consistency check" in str(link) for link in chain)
    return is_cut_short or any(each & _BROKEN and not each & _LASTING for each in names)


def is_unanswered(error: BaseException) -> bool:
    """Return whether the Hub gave no answer of its own, so that its latest one still counts."""
    return any(_SILENCE & set(class_names(link)) for link in cause_chain(error)) or is_transient(error)


def _limited_call(action: Callable[[], T], call: _Call, *, is_question: bool) -> T:
    """Return what an action gets from the Hub; TimeoutError where a question takes too long."""
    context = contextvars.copy_context()
    context.run(_CALL.set, call)
    if not is_question:
        return context.run(_hooked, action)
    # In a daemon that can be given up: the client has no limit for an answer that arrives byte by byte.
    with ThreadPool(1) as pool:
        result = pool.apply_async(context.run, (_hooked, action))
        while not result.ready():
            left_s = call.began_s + QUESTION_S - time.monotonic()
            if left_s <= 0:
                raise TimeoutError
            result.wait(left_s)
        answer: T = result.get()
        return answer


def _hooked(action: Callable[[], T]) -> T:
    """Return what an action gets from the Hub by a session that limits its answers."""
    session = import_module("huggingface_hub").get_session()
    # Before 1.0 it is a session of requests, and each thread has its own.
    hooks = session.event_hooks if hasattr(session, "event_hooks") else session.hooks
    if _check_answer not in hooks["response"]:
        hooks["response"].append(_check_answer)
    return action()


def _check_answer(response: Any, **_: Any) -> None:
    """Limit the body of an answer, and refuse it for its head."""
    request, call = response.request, _CALL.get()
    if call is not None:
        call.began_s = time.monotonic()
    # The client names files of its cache by these.
    for name in ("etag", "x-linked-etag", "x-repo-commit") if request.method == "HEAD" else ():
        value = response.headers.get(name, "").removeprefix("W/").strip('"')
        if value and ("/" in value or problem_of_name(value)):
            raise HubError(
                f"the Hub calls a file {value[:80]!r}, which is not a digest", next="check HF_ENDPOINT"
            )
    if response.status_code in _TRANSIENT_STATUS and requested_s(response.headers):
        # Raised at once: the caller waits, who can give a reason for it.
        import_module("huggingface_hub.utils").hf_raise_for_status(response)
    span = _RANGE.fullmatch(request.headers.get("Range", ""))
    most: float = int(span[2]) - int(span[1]) + 1 if span else call.most_bytes if call else float("inf")
    path = urlsplit(str(request.url)).path
    if response.status_code // 100 != 2 or "/api/" in path.partition("/resolve/")[0]:
        most = ANSWER_BYTES
    for name, limit in (("iter_raw", float("inf")), ("iter_bytes", most), ("iter_content", most)):
        if hasattr(response, name):  # the last is of requests
            setattr(response, name, _limited(getattr(response, name), limit))


def _limited(pieces: Callable[..., Iterator[bytes]], most: float) -> Callable[..., Iterator[bytes]]:
    """Return the method of an answer that yields its body, within the limits of bytes and time."""

    def limited(*args: Any, **options: Any) -> Iterator[bytes]:
        arrived = lately = 0
        since_s = time.monotonic()
        for piece in pieces(*args, **options):
            now_s = time.monotonic()
            arrived, lately = arrived + len(piece), lately + len(piece)
            if arrived > most:
                raise TooLargeError(f"more than the {most:,} bytes that were expected")
            if lately >= LEAST_BYTES:
                lately, since_s = 0, now_s
            elif now_s > since_s + WAIT_S:
                raise TimeoutError
            yield piece
            since_s += time.monotonic() - now_s  # the time of the reader does not count

    return limited
